//! A picture file as ground: PNG or JPEG, its middle square scaled to the size of the ground.
//!
//! The file is read when the configuration is; a scenario whose picture cannot be read is refused by its
//! check, and a record of a flight stays readable where the picture is not. The path `shipped:photo` is an aerial
//! photograph that is compiled in (its source and licence: `presets/grounds/photo.LICENSE`).

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use serde::{Deserialize, Serialize};

use super::frame::{CHANNELS, WIDE};

/// Largest decoded picture, bytes.
const LIMIT: usize = 1 << 28;

/// Path of the photograph that is compiled in.
const SHIPPED: &str = "shipped:photo";

/// Red, green and blue of a ground, or why there are none.
type Planes = Result<Arc<[Vec<f32>; CHANNELS]>, PictureError>;

/// The photograph that is compiled in.
static PHOTO: LazyLock<Planes> =
    LazyLock::new(|| ground_of(include_bytes!("../../presets/grounds/photo.jpg")));

fn ground_of(bytes: &[u8]) -> Planes {
    Ok(Arc::new(decode(bytes)?.scaled()))
}

/// A picture file and, if it could be read, what is in it. In a configuration it is its path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "PathBuf", into = "PathBuf")]
pub struct Picture {
    path: PathBuf,
    planes: Planes,
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
        if path == Path::new(SHIPPED) {
            return Self { path, planes: PHOTO.clone() };
        }
        let read = std::fs::read(&path).map_err(|error| PictureError::Read(error.to_string()));
        Self { path, planes: read.and_then(|bytes| ground_of(&bytes)) }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;

    /// A picture twice as wide as high: red, its middle square green and, below, blue.
    fn png(channels: png::ColorType) -> Vec<u8> {
        let (width, height) = (2 * WIDE as u32, WIDE as u32);
        let pixel = |n: u32| match (n % width, n / width) {
            (x, _) if x < width / 4 || x >= 3 * width / 4 => [255, 0, 0, 255],
            (_, y) if y < height / 2 => [0, 255, 0, 255],
            _ => [0, 0, 255, 255],
        };
        let pixels = (0..width * height).map(pixel);
        let data: Vec<u8> = pixels.flat_map(|p| p.into_iter().take(channels.samples())).collect();
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(channels);
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
        bytes
    }

    /// A file that is gone when this is dropped.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str, bytes: &[u8]) -> Self {
            let path = std::env::temp_dir().join(format!("crpl-{}-{name}", std::process::id()));
            std::fs::write(&path, bytes).unwrap();
            Self(path)
        }

        fn scenario(&self) -> Result<Scenario, anyhow::Error> {
            Scenario::from_toml(&format!("[camera.ground]\nkind = \"file\"\nfile = {:?}\n", self.0))
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    #[test]
    fn the_middle_square_of_a_picture_is_the_ground() {
        for channels in [png::ColorType::Rgb, png::ColorType::Rgba] {
            let file = Scratch::new(&format!("{channels:?}.png"), &png(channels));
            let scenario = file.scenario().unwrap();
            let frame = crate::Sim::new(scenario.clone(), 0).frame();
            assert_eq!([frame.pixel(0, 0), frame.pixel(99, 49)], [[0, 255, 0]; 2]);
            assert_eq!([frame.pixel(0, 50), frame.pixel(99, 99)], [[0, 0, 255]; 2]);
            // It is named in a record, and read again from there.
            let again = Scenario::from_toml(&toml::to_string(&scenario).unwrap()).unwrap();
            assert_eq!(again, scenario);
        }
    }

    #[test]
    fn a_jpeg_is_scaled_to_the_ground() {
        let file = Scratch::new("pattern.jpg", include_bytes!("pattern.jpg"));
        let frame = crate::Sim::new(file.scenario().unwrap(), 0).frame();
        // Red grows with the column and green with the row; the disc's blue is not where the obstacle is.
        let [left, right] = [frame.pixel(5, 90), frame.pixel(95, 90)];
        assert!(right[0] > left[0] + 120 && left[1] > 120 && left[2] < 100, "{left:?} {right:?}");
        assert!(frame.pixel(35, 35)[2] > 180);
    }

    #[test]
    fn the_shipped_photograph_is_a_ground_in_any_folder() {
        let mut scenario = Scenario::default();
        scenario.film_with("photo").unwrap();
        assert_eq!(Scenario::from_toml(&toml::to_string(&scenario).unwrap()).unwrap(), scenario);
        let picture = scenario.camera.ground.file.clone().unwrap();
        assert_eq!(picture.problem(), None);
        // What Pillow gives for the mean of the same file.
        for (plane, mean) in picture.planes().iter().zip([0.530, 0.596, 0.555]) {
            let found = plane.iter().sum::<f32>() / plane.len() as f32;
            assert!((found - mean).abs() < 0.005, "{found} {mean}");
        }
    }

    #[test]
    fn a_picture_that_cannot_be_read_is_refused_and_named() {
        for (name, bytes) in
            [("cut.png", &png(png::ColorType::Rgb)[..60]), ("junk.jpg", b"junk"), ("none", b"")]
        {
            let file = Scratch::new(name, bytes);
            let error = file.scenario().unwrap_err().to_string();
            assert!(error.starts_with("camera.ground.file = ") && error.contains(name), "{error}");
        }
        let nowhere = Scratch(PathBuf::from("/nowhere/ground.png"));
        let error = nowhere.scenario().unwrap_err().to_string();
        assert!(error.contains("No such file"), "{error}");
        let error = Scenario::from_toml("[camera.ground]\nkind = \"file\"\n").unwrap_err().to_string();
        assert_eq!(error, "camera.ground.file = nothing: must name a picture");
    }
}
