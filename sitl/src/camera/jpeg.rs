//! What a JPEG's quantisation does to a picture: 8x8 cosine blocks of brightness and colour, rounded to
//! the steps of a quality, without subsampling of the colours (4:4:4).

use multiversion::multiversion;

use super::canvas::Canvas;
use super::frame::{CHANNELS, SIDE};

/// Values along a block's side.
const BLOCK: usize = 8;
type Block = [[f32; BLOCK]; BLOCK];

/// Steps of brightness at quality 50 (ITU-T T.81, Annex K.1).
const BRIGHTNESS: [[u16; BLOCK]; BLOCK] = [
    [16, 11, 10, 16, 24, 40, 51, 61],
    [12, 12, 14, 19, 26, 58, 60, 55],
    [14, 13, 16, 24, 40, 57, 69, 56],
    [14, 17, 22, 29, 51, 87, 80, 62],
    [18, 22, 37, 56, 68, 109, 103, 77],
    [24, 35, 55, 64, 81, 104, 113, 92],
    [49, 64, 78, 87, 103, 121, 120, 101],
    [72, 92, 95, 98, 112, 100, 103, 99],
];
/// Steps of colour at quality 50.
const COLOUR: [[u16; BLOCK]; BLOCK] = [
    [17, 18, 24, 47, 99, 99, 99, 99],
    [18, 21, 26, 66, 99, 99, 99, 99],
    [24, 26, 56, 99, 99, 99, 99, 99],
    [47, 66, 99, 99, 99, 99, 99, 99],
    [99; BLOCK],
    [99; BLOCK],
    [99; BLOCK],
    [99; BLOCK],
];

/// The quantisation of one quality.
#[derive(Debug, Clone)]
pub(super) struct Quantiser {
    /// Steps of brightness and of both colours.
    steps: [Block; CHANNELS],
    inverse_steps: [Block; CHANNELS],
    /// Row u, column x: cosine u at place x.
    cosines: Block,
    transposed: Block,
}

impl Quantiser {
    /// For a quality from 1 to 100.
    pub fn new(quality: u32) -> Self {
        let quality = f64::from(quality.clamp(1, 100));
        let percent = if quality < 50.0 { 5000.0 / quality } else { 200.0 - 2.0 * quality };
        let step = |base: u16| ((f64::from(base) * percent + 50.0) / 100.0).floor().clamp(1.0, 255.0) as f32;
        let steps = [BRIGHTNESS, COLOUR, COLOUR].map(|table| table.map(|row| row.map(step)));
        let mut cosines = Block::default();
        let mut transposed = Block::default();
        for u in 0..BLOCK {
            for x in 0..BLOCK {
                let scale = if u == 0 { 0.5f64.sqrt() } else { 1.0 };
                let angle = (2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0;
                cosines[u][x] = (0.5 * scale * angle.cos()) as f32;
                transposed[x][u] = cosines[u][x];
            }
        }
        Self { inverse_steps: steps.map(|s| s.map(|row| row.map(f32::recip))), steps, cosines, transposed }
    }

    /// Rounds a picture of values from 0 to 255 as a JPEG of this quality does.
    pub fn apply(&self, canvas: &mut Canvas) {
        apply(self, canvas.planes_mut());
    }
}

/// Places of a block's pixels: beyond the frame's edge its last row and column again.
fn place(block: usize, n: usize) -> usize {
    (block * BLOCK + n).min(SIDE - 1)
}

#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2+fma"))]
fn apply(quantiser: &Quantiser, planes: [&mut [f32]; CHANNELS]) {
    let [red, green, blue] = planes;
    for top in 0..SIDE.div_ceil(BLOCK) {
        for left in 0..SIDE.div_ceil(BLOCK) {
            let mut blocks = load([red, green, blue], top, left);
            for (channel, block) in blocks.iter_mut().enumerate() {
                *block = quantised(quantiser, channel, block);
            }
            store([red, green, blue], &blocks, top, left);
        }
    }
}

/// Brightness and both colours of a block, brightness less 128.
#[inline(always)]
fn load(planes: [&[f32]; CHANNELS], top: usize, left: usize) -> [Block; CHANNELS] {
    let mut blocks = [Block::default(); CHANNELS];
    for y in 0..BLOCK {
        for x in 0..BLOCK {
            let at = place(top, y) * SIDE + place(left, x);
            let [r, g, b] = planes.map(|plane| plane[at]);
            let bright = 0.299 * r + 0.587 * g + 0.114 * b - 128.0;
            let blueish = -0.168_736 * r - 0.331_264 * g + 0.5 * b;
            let reddish = 0.5 * r - 0.418_688 * g - 0.081_312 * b;
            // In a file these are bytes.
            for (block, value) in blocks.iter_mut().zip([bright, blueish, reddish]) {
                block[y][x] = value.round_ties_even();
            }
        }
    }
    blocks
}

#[inline(always)]
fn store(planes: [&mut [f32]; CHANNELS], blocks: &[Block; CHANNELS], top: usize, left: usize) {
    let [red, green, blue] = planes;
    let [rows, columns] = [top, left].map(|n| BLOCK.min(SIDE - n * BLOCK));
    for y in 0..rows {
        let at = (top * BLOCK + y) * SIDE + left * BLOCK;
        for x in 0..columns {
            let [bright, blueish, reddish] = [0, 1, 2].map(|n: usize| blocks[n][y][x].round_ties_even());
            let bright = bright + 128.0;
            red[at + x] = bright + 1.402 * reddish;
            green[at + x] = bright - 0.344_136 * blueish - 0.714_136 * reddish;
            blue[at + x] = bright + 1.772 * blueish;
        }
    }
}

#[inline(always)]
fn quantised(quantiser: &Quantiser, channel: usize, block: &Block) -> Block {
    let (cosines, transposed) = (&quantiser.cosines, &quantiser.transposed);
    let mut waves = product(&product(cosines, block), transposed);
    let (steps, inverse) = (&quantiser.steps[channel], &quantiser.inverse_steps[channel]);
    for y in 0..BLOCK {
        for x in 0..BLOCK {
            waves[y][x] = (waves[y][x] * inverse[y][x]).round_ties_even() * steps[y][x];
        }
    }
    product(&product(transposed, &waves), cosines)
}

#[inline(always)]
fn product(a: &Block, b: &Block) -> Block {
    let mut c = Block::default();
    for i in 0..BLOCK {
        for k in 0..BLOCK {
            for j in 0..BLOCK {
                c[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 0 to 255, from a formula for each pixel's column and row.
    fn canvas(pixel: impl Fn(usize, usize) -> [f32; CHANNELS]) -> Canvas {
        let mut canvas = Canvas::black();
        for (channel, plane) in canvas.planes_mut().into_iter().enumerate() {
            for (n, value) in plane.iter_mut().enumerate() {
                *value = pixel(n % SIDE, n / SIDE)[channel];
            }
        }
        canvas
    }

    /// What `pattern.jpg` was made of, by Pillow at quality 50 without subsampling.
    fn pattern(x: usize, y: usize) -> [f32; CHANNELS] {
        let disc = (x as i64 - 50).pow(2) + (y as i64 - 40).pow(2) < 400;
        [x as f32 * 2.0, y as f32 * 2.0, if disc { 228.0 } else { 60.0 }]
    }

    fn after(quality: u32) -> Vec<u8> {
        let mut picture = canvas(pattern);
        Quantiser::new(quality).apply(&mut picture);
        picture.clamp();
        picture.into_frame().rgb().to_vec()
    }

    fn mean_difference(a: &[u8], b: &[u8]) -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
    }

    #[test]
    fn a_picture_comes_out_as_libjpeg_leaves_it() {
        let file: &[u8] = include_bytes!("pattern.jpg");
        let theirs = jpeg_decoder::Decoder::new(file).decode().unwrap();
        let [ours, before] = [after(50), canvas(pattern).into_frame().rgb().to_vec()];
        let (apart, change) = (mean_difference(&ours, &theirs), mean_difference(&before, &theirs));
        assert!(apart < 0.1 && change > 1.5, "{apart} apart, changed by {change}");
    }

    #[test]
    fn a_lower_quality_changes_more_and_the_best_almost_nothing() {
        let before = canvas(pattern).into_frame();
        let changes = [100, 90, 50, 10].map(|quality| mean_difference(&after(quality), before.rgb()));
        assert!(changes[0] < 0.5 && changes.is_sorted_by(|a, b| a < b), "{changes:?}");
    }
}
