//! The parameter protocol: list, read, set. Without socket and clock; what is lost is asked for again.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use crpl_sitl::link::dialect::{
    MavMessage, PARAM_ERROR_DATA, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA,
};
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::param::{MAX_NAME, ParamSet, ParamValue};
use crpl_sitl::link::packet::Packet;

use super::value::{Encoding, Kind, NoNumber, Number};
use crate::tools::retry::Question;
use crate::tools::session::Exchange;

/// Silence in a list after which what is missing is asked for, until the pace of the link is known; then so many
/// times the time between two values, within these bounds.
const PAUSE: Duration = Duration::from_millis(2500);
const PAUSES: f64 = 5.0;
const PAUSE_BOUNDS: [f64; 2] = [0.2, 10.0];
/// Missing parameters that are asked for at a time: no more than come in this many seconds.
const BATCH: usize = 20;
const BATCH_SECONDS: f64 = 4.0;
/// Index of a value that is told but not at its place in the list.
const NO_INDEX: u16 = u16::MAX;

/// A parameter of a vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Param {
    /// Name.
    pub name: String,
    /// Type.
    pub kind: Kind,
    /// Value.
    pub value: Number,
}

impl fmt::Display for Param {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<16} {}", self.name, self.value)
    }
}

/// Not a parameter's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no parameter's name: 1 to 16 letters, digits and underscores")]
pub struct NoName(String);

fn checked(name: &str) -> Result<(), NoName> {
    let good = (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(|b| b.is_ascii_graphic());
    if good { Ok(()) } else { Err(NoName(name.into())) }
}

/// A PARAM_VALUE: index, number of parameters, parameter.
fn value_of(packet: &Packet, target: (u8, u8), encoding: Encoding) -> Option<(u16, u16, Param)> {
    let told = ParamValue::of(packet).filter(|_| (packet.system, packet.component) == target)?;
    let kind = Kind::of(told.kind);
    let value = Number::decode(told.value, kind, encoding);
    Some((told.index, told.count, Param { name: told.name.lossy().into(), kind, value }))
}

/// Whether the vehicle says that it has no such parameter, or will not have it set so.
fn error_of(packet: &Packet, name: &str, target: (u8, u8)) -> Option<String> {
    if !packet.is::<PARAM_ERROR_DATA>() || (packet.system, packet.component) != target {
        return None;
    }
    let Some(MavMessage::PARAM_ERROR(error)) = packet.message() else { return None };
    if error.param_id.to_str() != Ok(name) {
        return None;
    }
    Some(match error.error as u8 {
        1 => format!("there is no parameter {name}"),
        2 => format!("{name}: the value is out of range"),
        3 => format!("{name}: permission denied"),
        6 => format!("{name}: read only"),
        code => format!("{name}: refused with error {code}"),
    })
}

/// All parameters, in the vehicle's order.
#[derive(Debug)]
pub struct List {
    target: (u8, u8),
    encoding: Encoding,
    count: Option<u16>,
    found: BTreeMap<u16, Param>,
    question: Question<()>,
    asked_again: u64,
    /// When the last value came, and the time between two values, s: its pace.
    last: Option<Duration>,
    gap: Option<f64>,
}

impl List {
    /// Of this system and component.
    #[must_use]
    pub fn new(target: (u8, u8), encoding: Encoding) -> Self {
        Self {
            target,
            encoding,
            count: None,
            found: BTreeMap::new(),
            question: Question::default(),
            asked_again: 0,
            last: None,
            gap: None,
        }
    }

    /// A value has come: how fast they come. Pauses count little, since most of them are losses.
    fn measure(&mut self, now: Duration) {
        if let Some(last) = self.last.replace(now) {
            let gap = now.saturating_sub(last).as_secs_f64();
            self.gap =
                Some(self.gap.map_or(gap, |known| known + 0.2 * (gap.min(4.0 * known + 0.05) - known)));
        }
    }

    /// How long a silence is one.
    fn pause(&self) -> Duration {
        let [least, most] = PAUSE_BOUNDS;
        self.gap.map_or(PAUSE, |gap| Duration::from_secs_f64((PAUSES * gap).clamp(least, most)))
    }

    /// How many are asked for at a time.
    fn batch(&self) -> usize {
        self.gap.map_or(BATCH, |gap| ((BATCH_SECONDS / gap.max(1e-3)) as usize).clamp(1, BATCH))
    }

    /// How many had to be asked for again.
    #[must_use]
    pub fn asked_again(&self) -> u64 {
        self.asked_again
    }

    fn missing(&self) -> impl Iterator<Item = u16> {
        (0..self.count.unwrap_or(0)).filter(|index| !self.found.contains_key(index))
    }
}

impl Exchange for List {
    type Output = Vec<Param>;

    fn packet(&mut self, packet: &Packet, now: Duration) {
        let Some((index, count, param)) = value_of(packet, self.target, self.encoding) else { return };
        if index == NO_INDEX {
            return;
        }
        self.count = Some(count);
        self.measure(now);
        let due = now + self.pause();
        if self.found.insert(index, param).is_none() {
            self.question.retry.go_on(due);
        } else {
            self.question.retry.not_before(due);
        }
        if self.missing().next().is_none() {
            self.question.answered(Ok(()));
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        let (count, found) = (self.count, self.found.len());
        let silence = || match count {
            None => "no answer to a request for the parameters".into(),
            Some(count) => format!("only {found} of {count} parameters came"),
        };
        if !self.question.fires(now, silence) {
            return;
        }
        let (target_system, target_component) = self.target;
        if self.count.is_none() {
            station.push(datagram, &PARAM_REQUEST_LIST_DATA { target_system, target_component });
            return;
        }
        let missing: Vec<u16> = self.missing().take(self.batch()).collect();
        let answered = self.pause().max(self.question.retry.due().saturating_sub(now));
        self.question.retry.not_before(now + answered);
        self.asked_again += missing.len() as u64;
        for index in missing {
            let ask = PARAM_REQUEST_READ_DATA {
                param_index: index as i16,
                target_system,
                target_component,
                ..Default::default()
            };
            station.push(datagram, &ask);
        }
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<Vec<Param>, String>> {
        let answer = self.question.take()?;
        Some(answer.map(|()| self.found.values().cloned().collect()))
    }
}

/// One parameter by its name.
#[derive(Debug)]
pub struct Read {
    name: String,
    target: (u8, u8),
    encoding: Encoding,
    question: Question<Param>,
}

impl Read {
    /// Of this system and component.
    ///
    /// # Errors
    /// The name or the value cannot be one of a parameter.
    pub fn new(name: String, target: (u8, u8), encoding: Encoding) -> Result<Self, NoName> {
        checked(&name)?;
        Ok(Self { name, target, encoding, question: Question::default() })
    }
}

impl Exchange for Read {
    type Output = Param;

    fn packet(&mut self, packet: &Packet, _now: Duration) {
        if let Some(why) = error_of(packet, &self.name, self.target) {
            self.question.answered(Err(why));
        }
        let value = value_of(packet, self.target, self.encoding);
        if let Some((.., param)) = value.filter(|(.., param)| param.name == self.name) {
            self.question.answered(Ok(param));
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        let silence = || format!("no answer for {}: is there such a parameter?", self.name);
        if !self.question.fires(now, silence) {
            return;
        }
        let ask = PARAM_REQUEST_READ_DATA {
            param_index: -1,
            target_system: self.target.0,
            target_component: self.target.1,
            param_id: self.name.as_str().into(),
        };
        station.push(datagram, &ask);
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<Param, String>> {
        self.question.take()
    }
}

/// What became of a value that was set.
#[derive(Debug, Clone, PartialEq)]
pub enum Written {
    /// The vehicle has it.
    Taken(Param),
    /// The vehicle keeps this.
    Kept(Param),
}

/// Sets one parameter.
#[derive(Debug)]
pub struct Set {
    message: ParamSet,
    wanted: Param,
    target: (u8, u8),
    encoding: Encoding,
    question: Question<Written>,
    /// Another value was told once, which may have crossed our question.
    contradicted: bool,
}

impl Set {
    /// Sets `param`, whose type is known, to `value`.
    ///
    /// # Errors
    /// The name or the value cannot be one of a parameter.
    pub fn new(param: &Param, value: Number, target: (u8, u8), encoding: Encoding) -> Result<Self, NoNumber> {
        let message = ParamSet {
            value: value.encode(encoding)?,
            target: target.into(),
            name: param.name.as_str().into(),
            kind: param.kind.code(),
        };
        Ok(Self {
            message,
            wanted: Param { value, ..param.clone() },
            target,
            encoding,
            question: Question::default(),
            contradicted: false,
        })
    }
}

impl Exchange for Set {
    type Output = Written;

    fn packet(&mut self, packet: &Packet, now: Duration) {
        if let Some(why) = error_of(packet, &self.wanted.name, self.target) {
            self.question.answered(Err(why));
            return;
        }
        let Some((.., param)) = value_of(packet, self.target, self.encoding) else { return };
        if param.name != self.wanted.name || !self.question.retry.asked() {
            return;
        }
        if param.value == self.wanted.value {
            self.question.answered(Ok(Written::Taken(param)));
        } else if self.contradicted {
            self.question.answered(Ok(Written::Kept(param)));
        } else {
            self.contradicted = true;
            self.question.retry.not_before(now);
        }
    }

    fn poll(&mut self, now: Duration, station: &mut Encoder, datagram: &mut Vec<u8>) {
        if !self.question.fires(now, || format!("no answer to setting {}", self.wanted.name)) {
            return;
        }
        station.push_view(datagram, &self.message);
    }

    fn due(&self) -> Option<Duration> {
        Some(self.question.retry.due())
    }

    fn outcome(&mut self) -> Option<Result<Written, String>> {
        self.question.take()
    }
}

#[cfg(test)]
mod tests;
