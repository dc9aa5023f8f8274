//! Bytes on their way out of a link, and where its datagrams end.

use crpl_sitl::link::encoder::DATAGRAM;

/// Bytes on their way out.
#[derive(Debug, Default)]
pub struct Outbox {
    pub bytes: Vec<u8>,
    /// Where datagrams end, but for the last: after how many bytes and frames.
    pub ends: Vec<(usize, u64)>,
    /// The datagram being routed, and where its frames begin: after how many bytes and frames.
    pub group: (u64, usize, u64),
    pub frames: u64,
}

impl Outbox {
    pub fn push(&mut self, frame: &[u8], group: u64) {
        let begin = self.ends.last().map_or(0, |end| end.0);
        if self.group.0 != group {
            self.group = (group, self.bytes.len(), self.frames);
        }
        let all = (self.bytes.len(), self.frames);
        if all.0 - begin + frame.len() > DATAGRAM && all.0 > begin {
            // Moves the whole group into the next datagram, if it is not this datagram already.
            let end = if self.group.1 > begin { (self.group.1, self.group.2) } else { all };
            self.ends.push(end);
            // The group may be too long for a datagram of its own.
            if all.0 - end.0 + frame.len() > DATAGRAM && all.0 > end.0 {
                self.ends.push(all);
            }
        }
        self.bytes.extend_from_slice(frame);
        self.frames += 1;
    }
}
