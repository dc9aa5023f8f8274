//! What vehicles say (STATUSTEXT), of which long texts come in several parts. No socket, no clock.

use std::collections::BTreeMap;

use crpl_sitl::link::messages::View;
use crpl_sitl::link::messages::status::{MAX_TEXT, StatusText};
use crpl_sitl::link::packet::Packet;

/// Senders whose unfinished texts are kept.
const MAX_SENDERS: usize = 64;
/// What stands for a part that has not come.
const GAP: &[u8] = b" ... ";

/// A text that somebody has said.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SaidText {
    /// Whose.
    pub system: u8,
    /// MAV_SEVERITY: 0 (emergency) to 7 (debug).
    pub severity: u8,
    /// All its parts.
    pub text: String,
}

impl SaidText {
    /// Whether it is a warning or worse.
    #[must_use]
    pub fn is_warning(&self) -> bool {
        self.severity <= 4
    }
}

/// A text that goes on.
#[derive(Debug)]
struct OpenText {
    id: u16,
    severity: u8,
    /// The part that comes next.
    next: u16,
    /// Parts may end inside a character.
    bytes: Vec<u8>,
}

impl OpenText {
    fn add(&mut self, part: &StatusText) {
        let number = u16::from(part.chunk_seq);
        if number > self.next {
            self.bytes.extend_from_slice(GAP);
        }
        self.bytes.extend_from_slice(part.text.bytes());
        self.next = number + 1;
    }

    fn said(&self, system: u8) -> SaidText {
        let text = String::from_utf8_lossy(&self.bytes).trim().to_owned();
        SaidText { system, severity: self.severity, text }
    }
}

/// Joins the parts of texts.
#[derive(Debug, Default)]
pub struct Texts {
    /// By system and component.
    open: BTreeMap<(u8, u8), OpenText>,
    /// The number of each sender's last whole text: parts of it that come again are none of a new one.
    done: BTreeMap<(u8, u8), u16>,
}

impl Texts {
    /// The texts that this packet ends: its own, and one before it whose end has not come.
    pub fn packet(&mut self, packet: &Packet) -> Vec<SaidText> {
        let Some(part) = StatusText::of(packet) else { return Vec::new() };
        let (from, system) = ((packet.system, packet.component), packet.system);
        let (severity, ends) = (part.severity, part.text.bytes().len() < MAX_TEXT);
        if part.id == 0 {
            return vec![SaidText { system, severity, text: part.text.lossy().into_owned() }];
        }
        let mut said = Vec::new();
        let goes_on = self.open.get(&from).is_some_and(|open| open.id == part.id);
        if goes_on && self.open.get(&from).is_some_and(|open| u16::from(part.chunk_seq) < open.next)
            || !goes_on && part.chunk_seq > 0 && self.done.get(&from) == Some(&part.id)
        {
            return said;
        }
        if !goes_on {
            if self.open.len() >= MAX_SENDERS && !self.open.contains_key(&from) {
                said.extend(self.unfinished());
            }
            let open = OpenText { id: part.id, severity, next: 0, bytes: Vec::new() };
            said.extend(self.open.insert(from, open).map(|before| before.said(system)));
        }
        let Some(open) = self.open.get_mut(&from) else { return said };
        open.add(&part);
        if ends {
            said.push(open.said(system));
            self.open.remove(&from);
            if self.done.len() >= MAX_SENDERS {
                self.done.clear();
            }
            self.done.insert(from, part.id);
        }
        said
    }

    /// The texts whose ends have not come, as far as they are known.
    pub fn unfinished(&mut self) -> Vec<SaidText> {
        std::mem::take(&mut self.open).into_iter().map(|((system, _), open)| open.said(system)).collect()
    }
}

#[cfg(test)]
mod tests {
    use crpl_sitl::link::decoder::Decoder;
    use crpl_sitl::link::encoder::Encoder;
    use crpl_sitl::link::messages::Text;

    use super::*;

    fn part(from: (u8, u8), id: u16, chunk_seq: u8, text: &[u8]) -> Packet {
        let mut bytes = [0; MAX_TEXT];
        bytes[..text.len()].copy_from_slice(text);
        let mut datagram = Vec::new();
        let message = StatusText { severity: 3, text: Text::from(bytes), id, chunk_seq };
        Encoder::new(from.0, from.1).push_view(&mut datagram, &message);
        Decoder::default().datagram(&datagram).remove(0)
    }

    fn texts(all: &mut Texts, packets: &[Packet]) -> Vec<String> {
        packets.iter().flat_map(|packet| all.packet(packet)).map(|said| said.text).collect()
    }

    const A: (u8, u8) = (1, 1);
    const B: (u8, u8) = (1, 100);

    /// The parts of a text of so many letters.
    fn parts(from: (u8, u8), id: u16, length: usize) -> Vec<Packet> {
        let text = vec![b'a'; length];
        let mut all: Vec<&[u8]> = text.chunks(MAX_TEXT).collect();
        if length.is_multiple_of(MAX_TEXT) {
            all.push(&[]);
        }
        (0_u8..).zip(all).map(|(number, text)| part(from, id, number, text)).collect()
    }

    /// Report A10: STATUSTEXT chunks (id, chunk_seq) were not joined.
    #[test]
    fn long_texts_are_joined_whoever_speaks_between() {
        for length in [51, 99, 100, 101, 250] {
            let (ours, theirs) = (parts(A, 7, length), parts(B, 7, length));
            let both: Vec<Packet> = ours.iter().zip(&theirs).flat_map(|(a, b)| [a, b]).cloned().collect();
            assert_eq!(texts(&mut Texts::default(), &both), ["a".repeat(length), "a".repeat(length)]);
        }
        let short = part(A, 0, 0, b"Radio Failsafe");
        assert_eq!(texts(&mut Texts::default(), &[short]), ["Radio Failsafe"]);
    }

    #[test]
    fn a_part_that_comes_twice_or_never_costs_no_more_than_itself() {
        let [first, second, third] = &parts(A, 7, 120)[..] else { panic!("three parts") };
        let mut all = Texts::default();
        let twice = [first, first, second, second, third, third, second].map(Clone::clone);
        assert_eq!(texts(&mut all, &twice), ["a".repeat(120)]);
        let (whole, end) = ("a".repeat(50), "a".repeat(20));
        let missing = [first.clone(), third.clone()];
        assert_eq!(texts(&mut Texts::default(), &missing), [format!("{whole} ... {end}")]);
        let late = [second.clone(), third.clone()];
        assert_eq!(texts(&mut Texts::default(), &late), [format!("... {whole}{end}")]);
        // Its end never comes: the next text brings it, or who asks for it.
        let next = [first.clone(), part(A, 8, 0, b"next")];
        assert_eq!(texts(&mut all, &next), [whole.clone(), "next".into()]);
        assert_eq!(texts(&mut all, &next[..1]), Vec::<String>::new());
        assert_eq!(all.unfinished()[0].text, whole);
        assert_eq!(all.unfinished(), []);
    }

    #[test]
    fn a_character_that_is_cut_in_two_comes_back_and_a_severity_without_a_name_is_no_silence() {
        let text = format!("{}é!", "a".repeat(49));
        let cut = text.as_bytes();
        let both = [part(A, 9, 0, &cut[..50]), part(A, 9, 1, &cut[50..])];
        assert_eq!(texts(&mut Texts::default(), &both), [text]);
        let mut datagram = Vec::new();
        let message = StatusText { severity: 77, text: Text::from("odd"), id: 0, chunk_seq: 0 };
        Encoder::new(1, 1).push_view(&mut datagram, &message);
        assert_eq!(Texts::default().packet(&Decoder::default().datagram(&datagram)[0])[0].text, "odd");
    }

    #[test]
    fn what_is_kept_is_bounded() {
        let mut all = Texts::default();
        let mut said = 0;
        for system in 0..=255 {
            for component in 0..=255 {
                said += all.packet(&parts((system, component), 7, 60)[0]).len();
            }
        }
        assert!(all.open.len() <= MAX_SENDERS && said >= 65_536 - MAX_SENDERS);
    }
}
