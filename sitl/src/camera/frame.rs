//! The frame that the camera takes: 100x100 RGB bytes, and which body has which channel.

/// Pixels along each side.
pub const SIDE: usize = 100;

/// Channels of a pixel: red (UAV), green (second obstacle), blue (all other obstacles).
pub const CHANNELS: usize = 3;

/// Maximum number of obstacles that colours tell apart.
pub const COLOURS: usize = OBSTACLE_CHANNELS.len();

/// Pixels of the ground beyond each side of the frame.
pub(super) const MARGIN: usize = 8;
/// Pixels along each side of the ground.
pub(super) const WIDE: usize = SIDE + 2 * MARGIN;

pub(super) const RED: usize = 0;
pub(super) const GREEN: usize = 1;
pub(super) const BLUE: usize = 2;

/// Channels of the first obstacles; further ones have the first channel.
pub(super) const OBSTACLE_CHANNELS: [usize; 2] = [BLUE, GREEN];

/// A frame: rows of pixels of three bytes.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    pub(super) bytes: Vec<u8>,
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Frame({SIDE}x{SIDE}, {} lit)", self.bytes.iter().filter(|&&b| b > 0).count())
    }
}

impl Frame {
    /// A black frame.
    #[must_use]
    pub fn black() -> Self {
        Self { bytes: vec![0; SIDE * SIDE * CHANNELS] }
    }

    /// The frame with these bytes, or `None` if there are not 100·100·3 of them.
    #[must_use]
    pub fn from_rgb(bytes: Vec<u8>) -> Option<Self> {
        (bytes.len() == SIDE * SIDE * CHANNELS).then_some(Self { bytes })
    }

    /// Row by row, three bytes a pixel.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        &self.bytes
    }

    /// The three bytes at column `x`, row `y`.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let at = (y * SIDE + x) * CHANNELS;
        [self.bytes[at], self.bytes[at + 1], self.bytes[at + 2]]
    }

    /// A frame of UAV and two obstacles as two frames of UAV and one: each obstacle in blue, as an
    /// encoder of one obstacle knows it. In the scenario's order.
    #[must_use]
    pub fn one_obstacle_each(&self) -> [Self; COLOURS] {
        OBSTACLE_CHANNELS.map(|channel| {
            let pixels = self.bytes.chunks_exact(CHANNELS);
            Self { bytes: pixels.flat_map(|pixel| [pixel[RED], 0, pixel[channel]]).collect() }
        })
    }
}
