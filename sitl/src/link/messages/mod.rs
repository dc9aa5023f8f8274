//! MAVLink payloads by named fields: the only place that knows where in a payload a field is.
//!
//! The `mavlink` crate's types refuse a message whose enum value they have no name for. A vehicle must
//! answer such a message, so a view reads and writes plain integers. Bytes that a sender cut off read as
//! zeros, as MAVLink 2 demands; `tests` compare each view with the crate's type, field by field.
//!
//! | module | messages |
//! |---|---|
//! | [`status`] | HEARTBEAT, STATUSTEXT, AUTOPILOT_VERSION, MESSAGE_INTERVAL |
//! | [`telemetry`] | LOCAL_POSITION_NED, GLOBAL_POSITION_INT, POSITION_TARGET_LOCAL_NED, DEBUG_VECT, NAMED_VALUE_FLOAT |
//! | [`setpoint`] | SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT |
//! | [`command`] | COMMAND_LONG, COMMAND_INT, COMMAND_ACK, SET_MODE |
//! | [`param`] | PARAM_VALUE, PARAM_SET, PARAM_REQUEST_READ, PARAM_REQUEST_LIST |
//! | [`mission`] | MISSION_ITEM and MISSION_ITEM_INT, MISSION_COUNT, requests, MISSION_ACK and the rest |
//! | [`image`] | DATA_TRANSMISSION_HANDSHAKE, ENCAPSULATED_DATA |
//! | [`service`] | PING, TIMESYNC, REQUEST_DATA_STREAM, FILE_TRANSFER_PROTOCOL, SETUP_SIGNING |
//!
//! A table row is `offset => field: type`, little-endian:
//!
//! ```text
//! Ping = PING_DATA {
//!     /// Stamp of the asker, µs.
//!     0 => time_usec: u64,
//! ```

#![expect(deprecated, reason = "vehicles and stations still use what the standard has superseded")]

use std::borrow::Cow;

use super::MessageData;
use super::packet::PacketRef;

pub use super::packet::Target;

/// The longest payload, bytes.
pub const MAX_PAYLOAD: usize = 255;

/// A payload read into named fields, and written from them.
pub trait View: Sized {
    /// The dialect's type of the same message.
    type Message: MessageData;
    /// The messages with this layout; [`View::Message`] is the first.
    const IDS: &'static [u32];

    /// The fields of a payload, which lacks the zeros at its end.
    #[must_use]
    fn read(payload: &[u8]) -> Self;

    /// The payload with these fields; zeros elsewhere and behind its end.
    #[must_use]
    fn payload(&self) -> [u8; MAX_PAYLOAD];

    /// The fields of a packet; `None` if it is another message.
    #[must_use]
    fn of<'a>(packet: impl Into<PacketRef<'a>>) -> Option<Self> {
        let packet = packet.into();
        Self::IDS.contains(&packet.id).then(|| Self::read(packet.payload()))
    }
}

/// A value in a payload.
pub trait Field: Copy {
    /// Its length, bytes.
    const SIZE: usize;

    /// The value at `at`. Beyond the end of `bytes` are zeros.
    fn read(bytes: &[u8], at: usize) -> Self;

    /// Writes the value to `at`, where there is room for it.
    fn write(self, bytes: &mut [u8; MAX_PAYLOAD], at: usize);
}

macro_rules! numbers {
    ($($number:ty)+) => {$(
        impl Field for $number {
            const SIZE: usize = size_of::<Self>();

            fn read(bytes: &[u8], at: usize) -> Self {
                let bytes = bytes.get(at..).and_then(|bytes| bytes.first_chunk());
                bytes.map_or(Self::default(), |bytes| Self::from_le_bytes(*bytes))
            }

            fn write(self, bytes: &mut [u8; MAX_PAYLOAD], at: usize) {
                bytes[at..at + Self::SIZE].copy_from_slice(&self.to_le_bytes());
            }
        }
    )+};
}
numbers!(u8 u16 u32 u64 i16 i32 i64 f32);

impl<T: Field, const N: usize> Field for [T; N] {
    const SIZE: usize = N * T::SIZE;

    fn read(bytes: &[u8], at: usize) -> Self {
        std::array::from_fn(|k| T::read(bytes, at + k * T::SIZE))
    }

    fn write(self, bytes: &mut [u8; MAX_PAYLOAD], at: usize) {
        for (k, value) in self.into_iter().enumerate() {
            value.write(bytes, at + k * T::SIZE);
        }
    }
}

/// A text of at most N bytes, with zeros behind its end if it is shorter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Text<const N: usize>([u8; N]);

impl<const N: usize> Text<N> {
    /// The text up to its first NUL; what is no UTF-8 is replaced.
    #[must_use]
    pub fn lossy(&self) -> Cow<'_, str> {
        String::from_utf8_lossy(self.bytes())
    }

    /// Its bytes up to its first NUL.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        let end = self.0.iter().position(|&byte| byte == 0).unwrap_or(N);
        &self.0[..end]
    }
}

impl<const N: usize> From<[u8; N]> for Text<N> {
    fn from(bytes: [u8; N]) -> Self {
        Self(bytes)
    }
}

impl<const N: usize> From<&str> for Text<N> {
    /// What does not fit is cut off.
    fn from(text: &str) -> Self {
        let mut bytes = [0; N];
        bytes.iter_mut().zip(text.bytes()).for_each(|(to, from)| *to = from);
        Self(bytes)
    }
}

impl<const N: usize> Field for Text<N> {
    const SIZE: usize = N;

    fn read(bytes: &[u8], at: usize) -> Self {
        Self(Field::read(bytes, at))
    }

    fn write(self, bytes: &mut [u8; MAX_PAYLOAD], at: usize) {
        self.0.write(bytes, at);
    }
}

impl Field for Target {
    const SIZE: usize = 2;

    fn read(bytes: &[u8], at: usize) -> Self {
        let [system, component] = Field::read(bytes, at);
        Self { system, component }
    }

    fn write(self, bytes: &mut [u8; MAX_PAYLOAD], at: usize) {
        [self.system, self.component].write(bytes, at);
    }
}

/// Declares views. `A | B` are messages with the same layout.
macro_rules! views {
    ($(
        $(#[$about:meta])* $name:ident = $message:ident $(| $twin:ident)* {
            $($(#[$field_about:meta])* $at:literal => $field:ident: $type:ty,)+
        }
    )+) => {$(
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $name {
            $($(#[$field_about])* pub $field: $type,)+
        }

        impl $crate::link::messages::View for $name {
            type Message = $crate::link::dialect::$message;
            const IDS: &'static [u32] = &[
                <$crate::link::dialect::$message as $crate::link::MessageData>::ID,
                $(<$crate::link::dialect::$twin as $crate::link::MessageData>::ID,)*
            ];

            fn read(payload: &[u8]) -> Self {
                const LENGTH: usize =
                    <$crate::link::dialect::$message as $crate::link::MessageData>::ENCODED_LEN;
                let mut bytes = [0; LENGTH];
                let length = payload.len().min(LENGTH);
                bytes[..length].copy_from_slice(&payload[..length]);
                Self { $($field: $crate::link::messages::Field::read(&bytes, $at),)+ }
            }

            fn payload(&self) -> [u8; $crate::link::messages::MAX_PAYLOAD] {
                let mut bytes = [0; _];
                $($crate::link::messages::Field::write(self.$field, &mut bytes, $at);)+
                bytes
            }
        }
    )+};
}

pub mod command;
pub mod image;
pub mod mission;
pub mod param;
pub mod service;
pub mod setpoint;
pub mod status;
pub mod telemetry;

#[cfg(test)]
mod tests;
