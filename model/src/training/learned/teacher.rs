//! The motion teacher: the largest compact thing that moves and is not the UAV.
//!
//! Where the middle picture of a triple differs from both others something was there and is not in the others:
//! the difference's centre, found by a mean shift, is a label-free first guess of z_u. It starts z_u off; constant
//! velocity and the radio make it exact.

use crpl_sitl::camera::{CHANNELS, Frame, SIDE};

use crate::world_model::learned::TeacherConfig;

/// Rounds of the mean shift.
const ROUNDS: usize = 3;

/// Centre of what moved in the middle picture, px, or `None` if nothing compact and large enough did.
/// `own` is the UAV there, px, by our own z_c.
#[must_use]
pub fn moved(pictures: [&Frame; 3], own: [f32; 2], config: &TeacherConfig) -> Option<[f32; 2]> {
    let [before, middle, after] = pictures.map(Frame::rgb);
    let own_squared = (config.own_radius_px as f32).powi(2);
    let mut excess = Vec::new();
    for n in 0..SIDE * SIDE {
        let at = n * CHANNELS;
        let difference: i32 = (at..at + CHANNELS)
            .map(|k| {
                let m = i32::from(middle[k]);
                (m - i32::from(before[k])).abs().min((m - i32::from(after[k])).abs())
            })
            .sum();
        let e = difference as f32 - config.threshold as f32;
        if e > 0.0 {
            let (x, y) = ((n % SIDE) as f32 + 0.5, (n / SIDE) as f32 + 0.5);
            if (x - own[0]).powi(2) + (y - own[1]).powi(2) > own_squared {
                excess.push([x, y, e]);
            }
        }
    }
    let radius_squared = (config.radius_px as f32).powi(2);
    for _ in 0..ROUNDS {
        let [x, y] = centre(&excess)?;
        excess.retain(|e| (e[0] - x).powi(2) + (e[1] - y).powi(2) < radius_squared);
    }
    let [x, y] = centre(&excess)?;
    let mass: f32 = excess.iter().map(|e| e[2]).sum();
    let wide = excess.iter().map(|e| e[2] * ((e[0] - x).powi(2) + (e[1] - y).powi(2))).sum::<f32>() / mass;
    let (area, [low, high]) = (excess.len() as f64, config.area_px);
    let believed = low < area && area < high && f64::from(wide.sqrt()) < config.width_px;
    believed.then_some([x, y])
}

fn centre(excess: &[[f32; 3]]) -> Option<[f32; 2]> {
    let mut sums = [0.0f32; 3];
    for [x, y, e] in excess {
        sums = [sums[0] + x * e, sums[1] + y * e, sums[2] + e];
    }
    (sums[2] > 0.0).then(|| [sums[0] / sums[2], sums[1] / sums[2]])
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Scenario;
    use crpl_sitl::camera::render;
    use nalgebra::Vector2;

    use super::*;

    fn seen(obstacles: [[f64; 2]; 3], own: [f32; 2]) -> Option<[f32; 2]> {
        let uavs = [[0.2, 0.2], [0.3, 0.2], [0.4, 0.2]];
        let frame =
            |k: usize| render(Vector2::from(uavs[k]), Vector2::from(obstacles[k]), &Scenario::default());
        let frames = [frame(0), frame(1), frame(2)];
        moved([&frames[0], &frames[1], &frames[2]], own, &TeacherConfig::default())
    }

    #[test]
    fn it_finds_the_obstacle_that_moves() {
        let p = seen([[0.5, 0.6], [0.6, 0.6], [0.7, 0.6]], [30.0, 20.0]).unwrap();
        assert!((p[0] - 60.0).abs() < 1.0 && (p[1] - 60.0).abs() < 1.0, "{p:?}");
    }

    #[test]
    fn it_says_nothing_where_nothing_but_the_uav_moves() {
        assert_eq!(seen([[0.5, 0.6]; 3], [30.0, 20.0]), None);
    }
}
