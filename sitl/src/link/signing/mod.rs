//! MAVLink 2 message signing (mavlink.io/en/guide/message_signing), for both programs. Knows frames,
//! the key and timestamps; reads no clock: `now` is an argument, see [`timestamp`].
//!
//! The `mavlink` crate signs too, but it reads the wall's clock itself, forgets its timestamps on a
//! restart, has no exception for radios and applies the one-minute rule to new streams alone.
//!
//! | frame | `Policy::Optional` | `Policy::Required` |
//! |---|---|---|
//! | signed with our key, newer than all of its stream and at most a minute old | good | good |
//! | signed otherwise | refused | refused |
//! | not signed | good | refused, but for RADIO_STATUS and RADIO |
//! | MAVLink 1 | not acted on anyhow | refused |
//!
//! Without a key nothing is signed and nothing is checked. A vehicle begins with `Required`: once SETUP_SIGNING has
//! brought a key, the unsigned are refused. A stream is a link, a system and a
//! component. The file of [`Store`] keeps the key and the newest timestamp of each stream, so a frame
//! recorded before a restart is refused after it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fmt, io};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::crc::{checksum, crc_extra};
use super::encoder::DATAGRAM;
use super::packet::{Header, Packet, PacketRef, SIGNED, TRAILER};
use super::{MessageData, dialect};

const STAMP: usize = 6;
/// The newest timestamp that there is: 48 bits.
const LAST_STAMP: u64 = (1 << (8 * STAMP)) - 1;
/// 2015-01-01 in seconds since 1970.
const EPOCH_S: u64 = 1_420_070_400;
/// Timestamps a second: one is 10 µs.
const PER_SECOND: u64 = 100_000;
const MINUTE: u64 = 60 * PER_SECOND;
/// How much may have been accepted since the file was last written, if the program was killed.
const UNSAVED: u64 = 2 * PER_SECOND;
/// RADIO_STATUS, and ArduPilot's older RADIO: what a modem injects, which has no key.
const FROM_MODEMS: [u32; 2] = [dialect::RADIO_STATUS_DATA::ID, 166];

/// A time since 1970 in units of signing: 10 µs since 2015, 48 bits.
#[must_use]
pub fn timestamp(unix: Duration) -> u64 {
    let since = unix.saturating_sub(Duration::from_secs(EPOCH_S));
    (since.as_micros() / 10) as u64 & LAST_STAMP
}

/// A secret key. It is never printed: its `Debug` says nothing, and it has no `Display`.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; 32]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key")
    }
}

impl Key {
    /// A key; none if all its bytes are zero, which is how SETUP_SIGNING says "off".
    #[must_use]
    pub fn new(bytes: [u8; 32]) -> Option<Self> {
        (bytes != [0; 32]).then_some(Self(bytes))
    }

    /// What tells this key from others, and from which nobody can learn it: the first 8 bytes of a SHA-256 of
    /// it, in hexadecimal.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        let digest =
            Sha256::new().chain_update(b"MAVLink signing key fingerprint").chain_update(self.0).finalize();
        to_hex(&digest[..8])
    }

    /// The key that ground stations derive from a passphrase: its SHA-256.
    #[must_use]
    pub fn of_passphrase(passphrase: &str) -> Self {
        Self(Sha256::digest(passphrase.as_bytes()).into())
    }

    /// The key's bytes, to send it in SETUP_SIGNING.
    #[must_use]
    pub fn bytes(&self) -> [u8; 32] {
        self.0
    }

    /// First 48 bits of SHA-256 over key, frame, link and timestamp.
    fn signature(&self, signed: &[u8]) -> [u8; STAMP] {
        let hash = Sha256::new().chain_update(self.0).chain_update(signed).finalize();
        std::array::from_fn(|i| hash[i])
    }
}

/// What becomes of frames without a signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Policy {
    /// They are taken.
    #[default]
    Optional,
    /// They are refused, once there is a key.
    Required,
}

/// How a good frame was good.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Its signature is right.
    Signed,
    /// It has none, or we have no key to check it.
    Unsigned,
}

/// Why a frame is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Rejection {
    /// It has no signature.
    #[error("unsigned")]
    Unsigned,
    /// Another key, or another content.
    #[error("wrong signature")]
    Signature,
    /// Not newer than the newest of its stream.
    #[error("replayed")]
    Replayed,
    /// More than a minute old.
    #[error("too old")]
    Old,
}

/// Key, policy and timestamps of a component.
#[derive(Debug, Clone, Default)]
pub struct Signing {
    key: Option<Key>,
    policy: Policy,
    /// The newest timestamp, sent or accepted.
    newest: u64,
    /// The newest accepted, by link, system and component.
    streams: BTreeMap<(u8, u8, u8), u64>,
    rejected: BTreeMap<Rejection, u64>,
    accepted: u64,
    changed: bool,
}

impl Signing {
    /// Signs with this key, if there is one.
    #[must_use]
    pub fn new(key: Option<Key>, policy: Policy) -> Self {
        Self { key, policy, ..Self::default() }
    }

    /// Whether there is a key.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.key.is_some()
    }

    /// The fingerprint of the key, if there is one.
    #[must_use]
    pub fn fingerprint(&self) -> Option<String> {
        self.key.as_ref().map(Key::fingerprint)
    }

    /// Whether both have the same key, or none.
    #[must_use]
    pub fn shares_key_with(&self, other: &Self) -> bool {
        self.key == other.key
    }

    /// Whether unsigned frames are refused.
    #[must_use]
    pub fn is_required(&self) -> bool {
        self.is_on() && self.policy == Policy::Required
    }

    /// What becomes of unsigned frames.
    #[must_use]
    pub fn policy(&self) -> Policy {
        self.policy
    }

    /// Sets what becomes of unsigned frames.
    pub fn set_policy(&mut self, policy: Policy) {
        self.policy = policy;
    }

    /// SETUP_SIGNING: another key, or none. Timestamps go on from `initial` at least.
    pub fn set_key(&mut self, key: Option<Key>, initial: u64) {
        if self.key != key {
            self.streams.clear();
        }
        self.key = key;
        self.newest = self.newest.max(initial.min(LAST_STAMP));
        self.changed = true;
    }

    /// Frames with a right signature so far.
    #[must_use]
    pub fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Frames refused so far, by reason.
    #[must_use]
    pub fn rejected(&self) -> &BTreeMap<Rejection, u64> {
        &self.rejected
    }

    /// Whether there is something new for the file since the last call.
    pub fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Checks a frame. Only a frame that is good changes any timestamp.
    ///
    /// # Errors
    /// Why the packet is not accepted: no signature, a wrong one, or an old timestamp.
    pub fn check(&mut self, packet: &Packet, now: u64) -> Result<Origin, Rejection> {
        let checked = self.examine(packet, now);
        match checked {
            Ok(Origin::Signed) => self.accepted += 1,
            Ok(Origin::Unsigned) => {}
            Err(rejection) => *self.rejected.entry(rejection).or_default() += 1,
        }
        checked
    }

    fn examine(&mut self, packet: &Packet, now: u64) -> Result<Origin, Rejection> {
        let Some(key) = &self.key else { return Ok(Origin::Unsigned) };
        if !PacketRef::from(packet).signed() {
            let taken = self.policy == Policy::Optional || FROM_MODEMS.contains(&packet.id);
            return if taken { Ok(Origin::Unsigned) } else { Err(Rejection::Unsigned) };
        }
        let (signed, signature) = packet.raw.split_at(packet.raw.len() - STAMP);
        // All bytes are compared, whatever the first ones say.
        let wrong = key.signature(signed).iter().zip(signature).fold(0, |wrong, (a, b)| wrong | (a ^ b));
        if wrong != 0 {
            return Err(Rejection::Signature);
        }
        let at = signed.len() - STAMP;
        let stamp = (0..STAMP).rev().fold(0, |stamp, i| stamp << 8 | u64::from(signed[at + i]));
        let stream = (signed[at - 1], packet.system, packet.component);
        if self.streams.get(&stream).is_some_and(|&newest| stamp <= newest) {
            return Err(Rejection::Replayed);
        }
        if stamp + MINUTE < self.newest.max(now) {
            return Err(Rejection::Old);
        }
        self.streams.insert(stream, stamp);
        self.newest = self.newest.max(stamp);
        self.changed = true;
        Ok(Origin::Signed)
    }

    /// The datagram with each of its frames signed, in as many datagrams as they then need. Without a
    /// key it stays as it is.
    pub fn sign(&mut self, datagram: Vec<u8>, link: u8, now: u64) -> Vec<Vec<u8>> {
        if self.key.is_none() {
            return vec![datagram];
        }
        let mut signed = vec![Vec::with_capacity(DATAGRAM)];
        for frame in frames(&datagram) {
            let frame = self.sign_frame(frame, link, now);
            match signed.last_mut() {
                Some(last) if last.is_empty() || last.len() + frame.len() <= DATAGRAM => last.extend(frame),
                _ => signed.push(frame),
            }
        }
        signed
    }

    fn sign_frame(&mut self, frame: &[u8], link: u8, now: u64) -> Vec<u8> {
        let unsigned = Header::of(frame).filter(|header| header.flags & SIGNED == 0);
        let extra = unsigned.and_then(|header| crc_extra(header.id));
        let (Some(key), Some(extra)) = (&self.key, extra) else { return frame.to_vec() };
        self.newest = (self.newest + 1).max(now).min(LAST_STAMP);
        self.changed = true;
        let mut out = Vec::with_capacity(frame.len() + TRAILER);
        out.extend_from_slice(&frame[..frame.len() - 2]);
        out[2] |= SIGNED;
        out.extend(checksum(&out[1..], extra).to_le_bytes());
        out.push(link);
        out.extend_from_slice(&self.newest.to_le_bytes()[..STAMP]);
        let signature = key.signature(&out);
        out.extend(signature);
        out
    }
}

/// The MAVLink 2 frames of a datagram that we made ourselves; what is no whole frame ends it.
pub fn frames(datagram: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = datagram;
    std::iter::from_fn(move || {
        let (frame, behind) = rest.split_at_checked(Header::of(rest)?.whole)?;
        rest = behind;
        Some(frame)
    })
}

/// A signed frame as it was before it was signed, for logs, which must hold no signature; any other
/// frame as it is.
#[must_use]
pub fn strip(frame: &[u8]) -> Vec<u8> {
    let signed = Header::of(frame).filter(|header| header.flags & SIGNED != 0);
    let found = signed.and_then(|header| Some((frame.get(..header.checked)?, crc_extra(header.id)?)));
    let Some((checked, extra)) = found else { return frame.to_vec() };
    let mut out = checked.to_vec();
    out[2] &= !SIGNED;
    out.extend(checksum(&out[1..], extra).to_le_bytes());
    out
}

/// Why a key file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Reading or writing failed.
    #[error("{doing} {path}: {source}")]
    File {
        /// What was being done.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It is no key file. The parser's own words could show the key, so they are left out.
    #[error(
        "reading {path}: no signing file; it needs key = \"64 hexadecimal digits\" or passphrase = \"...\""
    )]
    Content {
        /// The file.
        path: PathBuf,
    },
}

/// The file with the key and the timestamps: TOML, readable by its owner alone.
#[derive(Debug, Clone)]
pub struct Store {
    path: PathBuf,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    key: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    passphrase: Option<String>,
    #[serde(default)]
    timestamp: u64,
    /// Whether the program ended well after writing.
    #[serde(default = "yes")]
    clean: bool,
    /// Link, system, component, timestamp.
    #[serde(default)]
    streams: Vec<(u8, u8, u8, u64)>,
}

fn yes() -> bool {
    true
}

impl Store {
    /// The file at this path, which need not be there yet.
    #[must_use]
    pub fn new(path: &Path) -> Self {
        Self { path: path.into() }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file beside this one that one of several vehicles keeps for itself: `key.7.toml` of `key.toml`.
    #[must_use]
    pub fn of_system(&self, system: u8) -> Self {
        let part = |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
        let (stem, end) = (part(self.path.file_stem()), part(self.path.extension()));
        let dot = if end.is_empty() { "" } else { "." };
        Self { path: self.path.with_file_name(format!("{stem}.{system}{dot}{end}")) }
    }

    /// Key and timestamps; if there is no file, the key of `shared` alone.
    ///
    /// # Errors
    /// The file cannot be read, or holds no key.
    pub fn load_or(&self, shared: &Self, policy: Policy) -> Result<Signing, StoreError> {
        if self.path.exists() {
            return self.load(policy);
        }
        let Signing { key, newest, .. } = shared.load(policy)?;
        Ok(Signing { newest, ..Signing::new(key, policy) })
    }

    /// Key and timestamps; no key if there is no file.
    ///
    /// # Errors
    /// The file cannot be read, or holds no key.
    pub fn load(&self, policy: Policy) -> Result<Signing, StoreError> {
        let text = match std::fs::read_to_string(&self.path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Signing::new(None, policy)),
            Err(source) => return Err(self.failed("reading", source)),
        };
        let bad = || StoreError::Content { path: self.path.clone() };
        let content: Content = toml::from_str(&text).map_err(|_| bad())?;
        let key = match (&content.key, &content.passphrase) {
            (Some(hex), None) => Key::new(from_hex(hex).ok_or_else(bad)?),
            (None, Some(passphrase)) => Some(Key::of_passphrase(passphrase)),
            (None, None) => None,
            (Some(_), Some(_)) => return Err(bad()),
        };
        let late = if content.clean { 0 } else { UNSAVED };
        let streams =
            content.streams.iter().map(|&(link, s, c, stamp)| ((link, s, c), after(stamp, late))).collect();
        Ok(Signing { streams, newest: after(content.timestamp, late), ..Signing::new(key, policy) })
    }

    /// Writes key and timestamps; `clean` at the program's end.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, signing: &Signing, clean: bool) -> Result<(), StoreError> {
        let content = Content {
            key: signing.key.as_ref().map(|key| to_hex(&key.0)),
            passphrase: None,
            timestamp: signing.newest,
            clean,
            streams: signing.streams.iter().map(|(&(link, s, c), &stamp)| (link, s, c, stamp)).collect(),
        };
        let failed = |error: toml::ser::Error| self.failed("writing", io::Error::other(error));
        let body = toml::to_string(&content).map_err(failed)?;
        let text =
            format!("# MAVLink signing: secret key and newest timestamps. Keep it to yourself.\n{body}");
        // Written beside and renamed, so that no crash leaves half a file.
        let beside = self.path.with_extension("new");
        write_private(&beside, &text)
            .and_then(|()| std::fs::rename(&beside, &self.path))
            .map_err(|source| self.failed("writing", source))
    }

    fn failed(&self, doing: &'static str, source: io::Error) -> StoreError {
        StoreError::File { doing, path: self.path.clone(), source }
    }
}

/// A timestamp so much later.
fn after(stamp: u64, late: u64) -> u64 {
    stamp.saturating_add(late).min(LAST_STAMP)
}

fn write_private(path: &Path, text: &str) -> io::Result<()> {
    use std::io::Write;
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)?.write_all(text.as_bytes())
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex(text: &str) -> Option<[u8; 32]> {
    let digits: Option<Vec<u8>> = text.chars().map(|c| c.to_digit(16).map(|d| d as u8)).collect();
    let digits = digits.filter(|digits| digits.len() == 64)?;
    Some(std::array::from_fn(|i| digits[2 * i] << 4 | digits[2 * i + 1]))
}

#[cfg(test)]
mod tests;
