//! Message signing of what this program sends and receives: `--signing-key FILE`.
//!
//! With a key, every packet of this program is signed, and only packets with a valid signature are accepted
//! (and RADIO_STATUS, which the standard excepts). Packets between other peers pass unchanged, except in
//! `gcs bridge --signing-key`: it signs the vehicle's side and leaves the tools' side unsigned.

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, ensure};
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::signing::{Policy, Signing, Store, timestamp};

/// The link id in our signatures.
const LINK: u8 = 0;

/// Signs and checks packets with a key; keeps key and timestamps in a file.
#[derive(Debug)]
pub struct LinkSigner {
    signing: Signing,
    store: Store,
    decoder: Decoder,
}

impl LinkSigner {
    /// The key in this file: TOML with `key` (64 hexadecimal digits) or `passphrase`.
    ///
    /// # Errors
    /// The file cannot be read or written, or holds no key.
    pub fn open(path: &Path) -> Result<Self> {
        let store = Store::new(path);
        let signing = store.load(Policy::Required)?;
        ensure!(signing.is_on(), "--signing-key: there is no key in {}", path.display());
        // A restart before the final save continues from a later timestamp than any used.
        store.save(&signing, false)?;
        Ok(Self { signing, store, decoder: Decoder::default() })
    }

    /// Signs a datagram; the result may need several datagrams.
    pub fn sign(&mut self, datagram: &[u8]) -> Vec<Vec<u8>> {
        self.signing.sign(datagram.to_vec(), LINK, now())
    }

    /// The packets of a datagram with a valid signature.
    pub fn check_datagram(&mut self, datagram: &[u8]) -> Vec<u8> {
        let packets = self.decoder.datagram(datagram);
        self.signed(&packets)
    }

    /// The same for bytes of a link that has a decoder of its own. Messages that the dialect does not know are
    /// left out: their checksum cannot be verified.
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

    /// Number of packets refused so far.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.signing.rejected().values().sum()
    }

    /// Saves the timestamps; `end`: no later ones follow.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, end: bool) -> Result<()> {
        Ok(self.store.save(&self.signing, end)?)
    }
}

/// Before 1970 the clock is unset; the newest timestamp then counts on.
#[expect(clippy::disallowed_methods, reason = "MAVLink's signatures carry the wall's time")]
fn now() -> u64 {
    timestamp(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::dialect::HEARTBEAT_DATA;
    use crpl_sitl::link::encoder::Encoder;

    use super::*;

    fn signer(folder: &Path, name: &str, passphrase: &str) -> LinkSigner {
        let path = folder.join(name);
        std::fs::write(&path, format!("passphrase = \"{passphrase}\"\n")).unwrap();
        LinkSigner::open(&path).unwrap()
    }

    #[test]
    fn what_one_key_signs_another_refuses_and_nothing_passes_twice() {
        let folder = tempfile::tempdir().unwrap();
        let mut ours = signer(folder.path(), "ours", "secret");
        let mut theirs = signer(folder.path(), "theirs", "secret");
        let mut stranger = signer(folder.path(), "stranger", "another");
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
        let error = LinkSigner::open(&folder.path().join("nowhere")).unwrap_err().to_string();
        assert!(error.contains("there is no key"), "{error}");
    }
}
