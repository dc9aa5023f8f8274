//! Bytes of a link or of a log, without anybody who acts on them.

use crpl_gcs::tools::replay;
use crpl_gcs::tools::tlog::TlogInfo;
use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::image::{self, Reassembler};
use crpl_sitl::link::tlog::TlogReader;
use crpl_sitl::link::wire;

use crate::bytes::{Choices, frame};

/// Datagrams of one peer. The first byte says how they are cut, and whether they are a stream.
pub fn decoder(data: &[u8]) {
    let mut choices = Choices::new(data);
    let how = choices.byte();
    let mut decoder = if how & 1 == 0 { Decoder::default() } else { Decoder::of_stream() };
    let bytes = choices.rest();
    let mut frames = 0;
    for part in bytes.chunks(usize::from(how >> 1) + 1) {
        for packet in decoder.datagram(part) {
            frames += 1;
            assert!(packet.payload().len() <= 255);
            let _ = (packet.message(), wire::ask_of(&packet), wire::setpoint_of(&packet));
        }
    }
    let counts = decoder.counts();
    assert!(frames <= counts.frames);
    assert!(counts.garbage_bytes <= bytes.len() as u64);
}

/// A file as a picture, or messages of the image protocol: announcements and chunks.
pub fn image(data: &[u8]) {
    let mut choices = Choices::new(data);
    if choices.byte() & 1 == 0 {
        let _ = image::picture_from_png(choices.rest());
        return;
    }
    let (mut decoder, mut images) = (Decoder::default(), Reassembler::default());
    while !choices.is_empty() {
        let (what, length) = (choices.byte(), usize::from(choices.byte()));
        let id = if what & 1 == 0 { 130 } else { 131 };
        let payload = choices.some(if id == 130 { 13 } else { length });
        for packet in decoder.datagram(&frame(what, (1, 1), id, payload)) {
            images.push(&packet);
        }
    }
}

/// A telemetry log.
pub fn tlog(data: &[u8]) {
    let mut reader = TlogReader::new(data);
    let bytes: usize = reader.by_ref().map(|frame| frame.packet.raw.len() + 8).sum();
    let counts = reader.counts();
    assert_eq!(bytes as u64 + counts.skipped + counts.cut, data.len() as u64);
    let _ = (TlogInfo::of(data), replay::from_tlog(data, true));
}
