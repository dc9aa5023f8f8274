//! The MCAP container (<https://mcap.dev/spec>), as much of it as a finished flight needs: one chunk without compression,
//! its index, and a summary. Ours, because the crate of this name would have burn compiled anew.

use std::collections::BTreeMap;

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// What a record is.
#[derive(Debug, Clone, Copy)]
enum Opcode {
    Header = 0x01,
    Footer = 0x02,
    Schema = 0x03,
    Channel = 0x04,
    Message = 0x05,
    Chunk = 0x06,
    MessageIndex = 0x07,
    ChunkIndex = 0x08,
    Statistics = 0x0B,
    Metadata = 0x0C,
    MetadataIndex = 0x0D,
    DataEnd = 0x0F,
}

/// The content of a record; numbers are little-endian.
#[derive(Debug, Clone, Default)]
struct McapContent(Vec<u8>);

impl McapContent {
    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn put_u16(self, value: u16) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn put_u32(self, value: u32) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn put_u64(self, value: u64) -> Self {
        self.raw(&value.to_le_bytes())
    }

    /// Bytes behind their number.
    fn sized(self, bytes: &[u8]) -> Self {
        self.put_u32(bytes.len() as u32).raw(bytes)
    }

    fn put_text(self, text: &str) -> Self {
        self.sized(text.as_bytes())
    }

    fn texts(self, map: &[(&str, &str)]) -> Self {
        let pairs = map.iter().fold(Self::default(), |all, (key, value)| all.put_text(key).put_text(value));
        self.sized(&pairs.0)
    }

    /// Appends it as a record.
    fn write(self, out: &mut Vec<u8>, opcode: Opcode) {
        out.push(opcode as u8);
        out.extend_from_slice(&(self.0.len() as u64).to_le_bytes());
        out.extend_from_slice(&self.0);
    }
}

/// A log in memory.
#[derive(Debug, Default)]
pub struct McapLog {
    /// Header and metadata.
    head: Vec<u8>,
    /// Where the metadata are, for the summary.
    metadata: Vec<u8>,
    notes: u32,
    /// Schemas and channels, which stand in the chunk and in the summary.
    channels: Vec<u8>,
    count: u16,
    messages: Vec<u8>,
    /// Time and place in `messages` of each message, by channel.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

impl McapLog {
    /// An empty log, written by this program.
    #[must_use]
    pub fn new(library: &str) -> Self {
        let mut head = MAGIC.to_vec();
        McapContent::default().put_text("").put_text(library).write(&mut head, Opcode::Header);
        Self { head, ..Self::default() }
    }

    /// Notes beside the messages.
    pub fn metadata(&mut self, name: &str, notes: &[(&str, &str)]) {
        let at = self.head.len() as u64;
        McapContent::default().put_text(name).texts(notes).write(&mut self.head, Opcode::Metadata);
        let index = McapContent::default().put_u64(at).put_u64(self.head.len() as u64 - at).put_text(name);
        index.write(&mut self.metadata, Opcode::MetadataIndex);
        self.notes += 1;
    }

    /// A topic of JSON messages with their schema; gives the channel's number.
    pub fn channel(&mut self, topic: &str, name: &str, schema: &str) -> u16 {
        self.count += 1;
        let id = self.count;
        let schema =
            McapContent::default().put_u16(id).put_text(name).put_text("jsonschema").put_text(schema);
        schema.write(&mut self.channels, Opcode::Schema);
        let channel =
            McapContent::default().put_u16(id).put_u16(id).put_text(topic).put_text("json").texts(&[]);
        channel.write(&mut self.channels, Opcode::Channel);
        self.index.insert(id, Vec::new());
        id
    }

    /// A message of a time, ns since 1970.
    pub fn message(&mut self, channel: u16, time: u64, data: &[u8]) {
        let index = self.index.entry(channel).or_default();
        index.push((time, self.messages.len() as u64));
        let head =
            McapContent::default().put_u16(channel).put_u32(index.len() as u32).put_u64(time).put_u64(time);
        head.raw(data).write(&mut self.messages, Opcode::Message);
    }

    /// The first time and the last; zeros without a message.
    fn times(&self) -> (u64, u64) {
        let times = || self.index.values().flatten().map(|(time, _)| *time);
        (times().min().unwrap_or_default(), times().max().unwrap_or_default())
    }

    /// The whole file.
    #[must_use]
    pub fn finish(self) -> Vec<u8> {
        let (first, last) = self.times();
        let mut out = self.head.clone();
        let records = [self.channels.as_slice(), &self.messages].concat();
        let size = records.len() as u64;
        let chunk_at = out.len() as u64;
        let chunk = McapContent::default()
            .put_u64(first)
            .put_u64(last)
            .put_u64(size)
            .put_u32(0)
            .put_text("")
            .put_u64(size)
            .raw(&records);
        chunk.write(&mut out, Opcode::Chunk);
        let indices_at = out.len() as u64;
        let mut places = McapContent::default();
        for (channel, messages) in &self.index {
            places = places.put_u16(*channel).put_u64(out.len() as u64);
            let shift = self.channels.len() as u64;
            let mut entries: Vec<(u64, u64)> =
                messages.iter().map(|(time, at)| (*time, at + shift)).collect();
            entries.sort_unstable();
            let entries = entries
                .iter()
                .fold(McapContent::default(), |all, (time, at)| all.put_u64(*time).put_u64(*at));
            McapContent::default().put_u16(*channel).sized(&entries.0).write(&mut out, Opcode::MessageIndex);
        }
        let indices = out.len() as u64 - indices_at;
        McapContent::default().put_u32(0).write(&mut out, Opcode::DataEnd);
        let summary_at = out.len() as u64;
        out.extend_from_slice(&self.channels);
        self.statistics(first, last).write(&mut out, Opcode::Statistics);
        let chunk_index = McapContent::default()
            .put_u64(first)
            .put_u64(last)
            .put_u64(chunk_at)
            .put_u64(indices_at - chunk_at);
        let chunk_index =
            chunk_index.sized(&places.0).put_u64(indices).put_text("").put_u64(size).put_u64(size);
        chunk_index.write(&mut out, Opcode::ChunkIndex);
        out.extend_from_slice(&self.metadata);
        McapContent::default().put_u64(summary_at).put_u64(0).put_u32(0).write(&mut out, Opcode::Footer);
        out.extend_from_slice(&MAGIC);
        out
    }

    fn statistics(&self, first: u64, last: u64) -> McapContent {
        let counts = self.index.iter().map(|(channel, messages)| (*channel, messages.len() as u64));
        let each = counts
            .clone()
            .fold(McapContent::default(), |all, (channel, count)| all.put_u16(channel).put_u64(count));
        let all = counts.map(|(_, count)| count).sum();
        let head = McapContent::default()
            .put_u64(all)
            .put_u16(self.count)
            .put_u32(self.count.into())
            .put_u32(0)
            .put_u32(self.notes)
            .put_u32(1);
        head.put_u64(first).put_u64(last).sized(&each.0)
    }
}
