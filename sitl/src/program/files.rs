//! Files that are whole or absent, texts as people have them, and names for bytes.

use std::io;
use std::path::Path;

/// Writes a file in one go: first beside it, then over it, so that whatever ends the program leaves the
/// old file or the new one.
///
/// # Errors
/// If the folder cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let beside = path.with_file_name(format!(".{name}.new"));
    std::fs::write(&beside, bytes)?;
    std::fs::rename(&beside, path)
}

/// Reads a text as editors and stations write it; see [`text_of`].
///
/// # Errors
/// The file cannot be read.
pub fn read_text(path: &Path) -> io::Result<String> {
    std::fs::read(path).map(|bytes| text_of(&bytes))
}

/// The text of a file: UTF-8, or UTF-16 with a byte order mark as Windows has it; else each byte is a character, as in
/// Latin-1. Lines end in LF, CR LF or CR; what DOS and blocks of a disk leave behind the end (Ctrl-Z, NUL) is left
/// out, and so is the mark.
#[must_use]
pub fn text_of(bytes: &[u8]) -> String {
    let utf16 = |rest: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = rest.chunks_exact(2).map(|pair| unit([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    let text = match bytes {
        [0xFF, 0xFE, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xFE, 0xFF, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => text.into(),
            Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect(),
        },
    };
    let text = text.trim_start_matches('\u{feff}').trim_end_matches(['\0', '\u{1a}']);
    if text.contains('\n') { text.into() } else { text.replace('\r', "\n") }
}

/// FNV-1a, 64 bit, in hexadecimal: names bytes, guards against nobody.
#[must_use]
pub fn fingerprint(bytes: &[u8]) -> String {
    let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    format!("{hash:016x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `stream did not contain valid UTF-8` was the answer to files of Windows.
    #[test]
    fn texts_of_every_editor_are_read() {
        let text = "# 45° é\nA 1\n";
        assert_eq!(text_of(text.as_bytes()), text);
        assert_eq!(text_of(&[b"\xef\xbb\xbf", text.as_bytes()].concat()), text);
        assert_eq!(text_of(b"# 45\xb0 \xe9\nA 1\n"), text, "Latin-1");
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        assert_eq!(text_of(&[b"\xff\xfe", &little[..]].concat()), text);
        assert_eq!(text_of(&[b"\xfe\xff", &big[..]].concat()), text);
        assert_eq!(text_of(b"A 1\rB 2\r"), "A 1\nB 2\n", "CR alone");
        assert_eq!(text_of(b"A 1\r\n\x1a\0\0"), "A 1\r\n");
        assert_eq!(text_of(b""), "");
    }

    #[test]
    fn names_of_bytes_are_the_published_ones() {
        assert_eq!(fingerprint(b""), "cbf29ce484222325");
        assert_eq!(fingerprint(b"foobar"), "85944171f73967e8");
    }
}
