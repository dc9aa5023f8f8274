//! A picture file as ground: PNG or JPEG, its middle square scaled to the size of the ground.
//!
//! The file is read when the configuration is; a scenario whose picture cannot be read is refused by its
//! check, and a record of a flight stays readable where the picture is not.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::frame::{CHANNELS, WIDE};

/// Largest decoded picture, bytes.
const LIMIT: usize = 1 << 28;

/// A picture file and, if it could be read, what is in it. In a configuration it is its path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "PathBuf", into = "PathBuf")]
pub struct Picture {
    path: PathBuf,
    planes: Result<Arc<[Vec<f32>; CHANNELS]>, PictureError>,
}

/// Why a picture cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// The file could not be read.
    #[error("{0}")]
    Read(String),
    /// It is neither PNG nor JPEG, or a damaged one.
    #[error("{0}")]
    Decode(String),
    /// Its pixels are neither grey nor RGB.
    #[error("its pixels are neither grey nor RGB")]
    Pixels,
}

impl From<PathBuf> for Picture {
    fn from(path: PathBuf) -> Self {
        let read = std::fs::read(&path).map_err(|error| PictureError::Read(error.to_string()));
        let planes = read.and_then(|bytes| Ok(Arc::new(decode(&bytes)?.scaled())));
        Self { path, planes }
    }
}

impl From<Picture> for PathBuf {
    fn from(picture: Picture) -> Self {
        picture.path
    }
}

impl Picture {
    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Why it cannot be used, if it cannot.
    #[must_use]
    pub fn problem(&self) -> Option<&PictureError> {
        self.planes.as_ref().err()
    }

    /// Red, green and blue, `WIDE` x `WIDE` values each, 0 to 1; black if it could not be read.
    pub(super) fn planes(&self) -> [Vec<f32>; CHANNELS] {
        match &self.planes {
            Ok(planes) => planes.as_ref().clone(),
            Err(_) => [(); CHANNELS].map(|()| vec![0.0; WIDE * WIDE]),
        }
    }
}

/// A decoded picture: rows of pixels of `channels` bytes.
struct Decoded {
    width: usize,
    height: usize,
    channels: usize,
    bytes: Vec<u8>,
}

fn decode(bytes: &[u8]) -> Result<Decoded, PictureError> {
    if bytes.starts_with(b"\x89PNG") { decode_png(bytes) } else { decode_jpeg(bytes) }
}

fn decode_png(bytes: &[u8]) -> Result<Decoded, PictureError> {
    let failed = |error: png::DecodingError| PictureError::Decode(error.to_string());
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: LIMIT });
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(failed)?;
    let size = reader.output_buffer_size().filter(|&size| size <= LIMIT);
    let size = size.ok_or_else(|| PictureError::Decode("the picture is too large".into()))?;
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels).map_err(failed)?;
    pixels.truncate(info.buffer_size());
    let (width, height) = (info.width as usize, info.height as usize);
    Ok(Decoded { width, height, channels: info.color_type.samples(), bytes: pixels })
}

fn decode_jpeg(bytes: &[u8]) -> Result<Decoded, PictureError> {
    let failed = |error: jpeg_decoder::Error| PictureError::Decode(error.to_string());
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_max_decoding_buffer_size(LIMIT);
    let bytes = decoder.decode().map_err(failed)?;
    let info = decoder.info().ok_or(PictureError::Pixels)?;
    let channels = match info.pixel_format {
        jpeg_decoder::PixelFormat::L8 => 1,
        jpeg_decoder::PixelFormat::RGB24 => CHANNELS,
        jpeg_decoder::PixelFormat::L16 | jpeg_decoder::PixelFormat::CMYK32 => {
            return Err(PictureError::Pixels);
        }
    };
    Ok(Decoded { width: info.width.into(), height: info.height.into(), channels, bytes })
}

impl Decoded {
    /// The middle square, each ground pixel the mean of the pixels that it covers.
    fn scaled(&self) -> [Vec<f32>; CHANNELS] {
        let side = self.width.min(self.height);
        let (left, top) = ((self.width - side) / 2, (self.height - side) / 2);
        let span = |n: usize| {
            let first = n * side / WIDE;
            first..((n + 1) * side / WIDE).max(first + 1)
        };
        let mut planes = [(); CHANNELS].map(|()| Vec::with_capacity(WIDE * WIDE));
        for (row, column) in (0..WIDE).flat_map(|row| (0..WIDE).map(move |column| (row, column))) {
            let places = span(row).flat_map(|y| span(column).map(move |x| (x, y)));
            let mut sums = [0u64; CHANNELS];
            for (x, y) in places {
                let at = ((top + y) * self.width + left + x) * self.channels;
                for (channel, sum) in sums.iter_mut().enumerate() {
                    *sum += u64::from(self.bytes[at + if self.channels < CHANNELS { 0 } else { channel }]);
                }
            }
            let count = span(row).len() * span(column).len();
            for (plane, sum) in planes.iter_mut().zip(sums) {
                plane.push(sum as f32 / (count as f32 * 255.0));
            }
        }
        planes
    }
}
