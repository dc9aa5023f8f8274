//! Message signing of what this program says and hears: `--signing-key FILE`.
//!
//! With a key every frame of ours is signed, and only frames with a right signature are heard (and the
//! radio's, which the standard excepts). What passes between others passes as it is, but for `gcs bridge
//! --signing-key`: there the vehicle's side is signed and the other is not.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, ensure};
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::signing::{Policy, Signing, Store, timestamp};

/// The link id in our signatures.
const LINK: u8 = 0;

/// Key and timestamps, and the file in which they are kept.
#[derive(Debug)]
pub struct Seal {
    signing: Signing,
    store: Store,
    decoder: Decoder,
}

impl Seal {
    /// The key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`.
    pub fn open(path: &Path) -> Result<Self> {
        let store = Store::new(path);
        let signing = store.load(Policy::Required)?;
        ensure!(signing.is_on(), "--signing-key: there is no key in {}", path.display());
        // Until the end is written, a restart counts on timestamps that were not.
        store.save(&signing, false)?;
        Ok(Self { signing, store, decoder: Decoder::default() })
    }

    /// A datagram of ours, signed, in as many as it then needs.
    pub fn sign(&mut self, datagram: &[u8]) -> Vec<Vec<u8>> {
        self.signing.sign(datagram.to_vec(), LINK, now())
    }

    /// The frames of a datagram that are signed as they must be.
    pub fn check_datagram(&mut self, datagram: &[u8]) -> Vec<u8> {
        let packets = self.decoder.datagram(datagram);
        self.signed(&packets)
    }

    /// The same of what has come on a link with a decoder of its own. A message that the dialect does not
    /// know is not among them: its checksum cannot be told.
    pub fn check(&mut self, decoder: &mut Decoder, bytes: &[u8]) -> Vec<u8> {
        self.signed(&decoder.datagram(bytes))
    }

    fn signed(&mut self, packets: &[Packet]) -> Vec<u8> {
        let mut good = Vec::new();
        for packet in packets {
            match self.signing.check(packet, now()) {
                Ok(_) => good.extend_from_slice(&packet.raw),
                Err(why) => {
                    tracing::debug!(system = packet.system, component = packet.component, "refused: {why}");
                }
            }
        }
        good
    }

    /// Frames refused so far.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.signing.rejected().values().sum()
    }

    /// Writes the timestamps; at the `end`, no later ones are to be reckoned with.
    pub fn save(&self, end: bool) -> Result<()> {
        Ok(self.store.save(&self.signing, end)?)
    }
}

/// A clock before 1970 is no clock; the newest timestamp then counts on.
#[expect(clippy::disallowed_methods, reason = "MAVLink's signatures carry the wall's time")]
fn now() -> u64 {
    timestamp(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::dialect::HEARTBEAT_DATA;
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    fn seal(folder: &Path, name: &str, passphrase: &str) -> Seal {
        let path = folder.join(name);
        std::fs::write(&path, format!("passphrase = \"{passphrase}\"\n")).unwrap();
        Seal::open(&path).unwrap()
    }

    #[test]
    fn what_one_key_signs_another_refuses_and_nothing_passes_twice() {
        let folder = tempfile::tempdir().unwrap();
        let mut ours = seal(folder.path(), "ours", "secret");
        let mut theirs = seal(folder.path(), "theirs", "secret");
        let mut stranger = seal(folder.path(), "stranger", "another");
        let mut datagram = Vec::new();
        Encoder::new(255, 190).push(&mut datagram, &HEARTBEAT_DATA::default());
        let signed = ours.sign(&datagram).concat();
        assert_eq!(theirs.check_datagram(&signed), signed);
        assert!(theirs.check_datagram(&signed).is_empty(), "a replay");
        assert!(stranger.check_datagram(&signed).is_empty(), "another key");
        assert!(theirs.check_datagram(&datagram).is_empty(), "unsigned");
        ours.save(true).unwrap();
        let text = std::fs::read_to_string(folder.path().join("ours")).unwrap();
        assert!(text.contains("clean = true"), "{text}");
        let error = Seal::open(&folder.path().join("nowhere")).unwrap_err().to_string();
        assert!(error.contains("there is no key"), "{error}");
    }
}
