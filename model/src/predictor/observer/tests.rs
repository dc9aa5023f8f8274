//! The observer on flights that are known exactly.

use crpl_sitl::world::noise::{Noise, Stream};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::predictor::linear::PlaneLinear;

const SCALE: f64 = 10.0;

fn motion(gust: f64) -> MotionModel {
    let (two, one) = (Matrix2::identity() * 2.0, Matrix2::identity());
    let ca = Matrix2::new(0.035, 0.001, -0.002, 0.034);
    let linear = PlaneLinear { newer: two, older: -one, action: ca };
    MotionModel::new(Predictor::Linear(linear), SCALE, 0.04, gust)
}

/// A flight that obeys `motion`: places, and the action flown before each.
fn flight(
    motion: &MotionModel,
    steps: usize,
    gust: f64,
    rng: &mut impl Rng,
) -> Vec<(Vector2<f64>, Vector2<f64>)> {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let mut state = Vector4::new(1.0, -2.0, 0.1, 0.05);
    let mut out = vec![(Vector2::new(1.0, -2.0), Vector2::zeros())];
    for k in 0..steps {
        let a = Vector2::new((k as f64 * 1.3).sin(), (k as f64 * 0.7).cos());
        let pushed = a + Vector2::new(normal(), normal()) * (gust / 0.0035);
        state = motion.step(&state, pushed).0;
        out.push((state.fixed_rows::<2>(0).into_owned(), a));
    }
    out
}

fn truth(flight: &[(Vector2<f64>, Vector2<f64>)]) -> Estimate {
    let [.., before, now] = flight else { unreachable!("a flight has two places") };
    Estimate { y: now.0, v: now.0 - before.0 }
}

fn apart(a: Estimate, b: Estimate) -> f64 {
    (a.y - b.y).norm().max((a.v - b.v).norm())
}

#[test]
fn without_noise_it_is_exact_for_every_window() {
    let mut rng = Noise::new(1).generator(Stream::Evaluation, 0);
    let flight = flight(&motion(0.0), 40, 0.0, &mut rng);
    for window in [2, 3, 10, 20, 50] {
        for gust in [0.0, 0.0015] {
            let mut observer = LatentObserver::new(motion(gust), window);
            for (y, a) in &flight {
                observer.observe(*y, &[*a]);
            }
            let off = apart(observer.estimate().unwrap(), truth(&flight));
            assert!(off < 1e-6, "window {window}, gust {gust}: off by {off}");
        }
    }
}

#[test]
fn two_frames_are_the_difference_and_one_stands_still() {
    let mut observer = LatentObserver::new(motion(0.0), 2);
    assert_eq!(observer.estimate(), None);
    observer.observe(Vector2::new(1.0, 2.0), &[]);
    assert_eq!(observer.estimate(), Some(Estimate { y: Vector2::new(1.0, 2.0), v: Vector2::zeros() }));
    observer.observe(Vector2::new(1.1, 1.9), &[Vector2::new(1.0, 0.0)]);
    let found = observer.estimate().unwrap();
    let wanted = Estimate { y: Vector2::new(1.1, 1.9), v: Vector2::new(0.1, -0.1) };
    assert!(apart(found, wanted) < 1e-6, "{found:?}");
}

#[test]
fn more_frames_see_the_speed_better_and_gusts_are_not_averaged_away() {
    let mut rng = Noise::new(2).generator(Stream::Evaluation, 0);
    let speed_error = |window: usize, reckoned: f64, gust: f64, rng: &mut _| -> f64 {
        let squares: Vec<f64> = (0..200)
            .map(|_| {
                let flight = flight(&motion(0.0), 30, gust, rng);
                let mut observer = LatentObserver::new(motion(reckoned), window);
                for (y, a) in &flight {
                    let noise = Vector2::new(StandardNormal.sample(rng), StandardNormal.sample(rng));
                    observer.observe(y + noise * (SCALE * FRAME_NOISE), &[*a]);
                }
                (observer.estimate().unwrap().v - truth(&flight).v).norm_squared()
            })
            .collect();
        (squares.iter().sum::<f64>() / 200.0).sqrt() / (SCALE * FRAME_NOISE)
    };
    // Least squares: the speed's variance is 12/(M(M²-1)) of a frame's in each axis, and twice at 2.
    let (two, twenty) = (speed_error(2, 0.0, 0.0, &mut rng), speed_error(20, 0.0, 0.0, &mut rng));
    assert!((1.7..2.3).contains(&two), "{two}");
    let ideal = (24.0f64 / (20.0 * 399.0)).sqrt();
    assert!((0.8 * ideal..1.3 * ideal).contains(&twenty), "{twenty} instead of {ideal}");
    // In gusts five times a frame's error, the filter that reckons with them is no worse than two.
    let (two, kalman) = (speed_error(2, 0.0, 0.0015, &mut rng), speed_error(20, 0.0015, 0.0015, &mut rng));
    assert!(kalman < 1.02 * two, "{kalman} with 20 frames, {two} with 2");
}

#[test]
fn a_missing_frame_is_bridged_by_the_actions_flown() {
    let mut rng = Noise::new(3).generator(Stream::Evaluation, 0);
    let flight = flight(&motion(0.0), 30, 0.0, &mut rng);
    let mut observer = LatentObserver::new(motion(0.0), 20);
    let mut pending = Vec::new();
    for (k, (y, a)) in flight.iter().enumerate() {
        pending.push(*a);
        if ![12, 13, 14, 27].contains(&k) {
            observer.observe(*y, &pending);
            pending.clear();
        }
    }
    let off = apart(observer.estimate().unwrap(), truth(&flight));
    assert!(off < 1e-6, "off by {off}");
    // A gap longer than the window leaves one frame, of which no speed is known.
    observer.observe(Vector2::new(3.0, 3.0), &[Vector2::zeros(); 100]);
    assert_eq!(observer.estimate().unwrap().v, Vector2::zeros());
}

#[test]
fn ahead_is_where_the_same_actions_lead() {
    let mut rng = Noise::new(5).generator(Stream::Evaluation, 0);
    let flight = flight(&motion(0.0), 40, 0.0, &mut rng);
    let mut observer = LatentObserver::new(motion(0.0), 20);
    flight[..=25].iter().for_each(|(y, a)| observer.observe(*y, &[*a]));
    let flown: Vec<_> = flight[26..].iter().map(|(_, a)| *a).collect();
    let now = observer.estimate().unwrap();
    assert!(apart(observer.ahead(now, &flown), truth(&flight)) < 1e-6);
    assert_eq!(observer.ahead(now, &[]), now);
}

/// A UAV in gusts beside an obstacle that stands, as a camera shows them that shakes by so many units; the error
/// of the UAV's place and speed, root mean square, alone and steadied by the obstacle.
fn errors_with_shake(shake: f64) -> [f64; 4] {
    let mut rng = Noise::new(6).generator(Stream::Evaluation, 0);
    let learned = |gust| MotionModel { lost: true, ..motion(gust) };
    let mut sums = [0.0; 4];
    for _ in 0..60 {
        let flight = flight(&motion(0.0), 60, 0.0015, &mut rng);
        let mut c = LatentObserver::new(learned(0.0015), 20);
        let mut u = LatentObserver::new(learned(0.0), 20).remembering(STEADY_MEMORY);
        for (y, a) in &flight {
            let mut normal = |size: f64| {
                let [x, y]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
                Vector2::new(x, y) * (SCALE * size)
            };
            let (off, own, others) = (normal(shake), normal(FRAME_NOISE), normal(FRAME_NOISE));
            c.observe(y + off + own, &[*a]);
            u.observe(Vector2::new(2.0, 1.0) + off + others, &[Vector2::zeros()]);
        }
        let (truth, alone) = (truth(&flight), c.estimate().unwrap());
        let steady = steadied(&c, &u).map_or(alone, |(c, _)| c);
        for (k, found) in [alone, steady].into_iter().enumerate() {
            sums[2 * k] += (found.y - truth.y).norm_squared() / 60.0;
            sums[2 * k + 1] += (found.v - truth.v).norm_squared() / 60.0;
        }
    }
    sums.map(|square| square.sqrt() / SCALE)
}

#[test]
fn an_obstacle_steadies_a_camera_that_shakes() {
    let [place, speed, steady_place, steady_speed] = errors_with_shake(0.01);
    assert!(steady_place < 0.3 * place, "{steady_place} of {place}");
    assert!(steady_speed < 0.5 * speed, "{steady_speed} of {speed}");
    // One that does not shake is left alone, to the last bit.
    let [place, speed, steady_place, steady_speed] = errors_with_shake(0.0);
    assert_eq!([place, speed], [steady_place, steady_speed]);
}

#[test]
fn the_action_flown_counts_and_not_another() {
    let mut rng = Noise::new(4).generator(Stream::Evaluation, 0);
    let flight = flight(&motion(0.0), 25, 0.0, &mut rng);
    let watch = |told: &dyn Fn(usize) -> Vector2<f64>| {
        let mut observer = LatentObserver::new(motion(0.0), 20);
        for (k, (y, _)) in flight.iter().enumerate() {
            observer.observe(*y, &[told(k)]);
        }
        apart(observer.estimate().unwrap(), truth(&flight))
    };
    let flown = watch(&|k| flight[k].1);
    // Told what was sent in an outage of the last four intervals, and not what was held: too little
    // for the gate to see.
    let sent = watch(&|k| flight[k].1 + Vector2::new(if k < 21 { 0.0 } else { 0.2 }, 0.0));
    assert!(flown < 1e-6 && sent > 1e-3, "{flown} and {sent}");
}

#[test]
fn one_poor_frame_spoils_nothing() {
    let mut rng = Noise::new(6).generator(Stream::Evaluation, 0);
    let flight = flight(&motion(0.0), 25, 0.0, &mut rng);
    let mut observer = LatentObserver::new(motion(0.0), 20);
    for (k, (y, a)) in flight.iter().enumerate() {
        let wrong = if k == 22 { 15.0 * SCALE * FRAME_NOISE } else { 0.0 };
        observer.observe(y + Vector2::new(wrong, 0.0), &[*a]);
    }
    let off = (observer.estimate().unwrap().v - truth(&flight).v).norm();
    // Two frames around it would be wrong by 15 standard deviations.
    assert!(off < 0.5 * SCALE * FRAME_NOISE, "off by {off}");
}

#[test]
fn a_frame_that_shows_the_body_elsewhere_breaks_nothing_where_bodies_are_lost() {
    let mut rng = Noise::new(6).generator(Stream::Evaluation, 1);
    let lost = MotionModel { lost: true, ..motion(0.0) };
    let flight = flight(&lost, 25, 0.0, &mut rng);
    let watch = |motion: &MotionModel, gone: &[usize]| {
        let mut observer = LatentObserver::new(motion.clone(), 20);
        for (k, (y, a)) in flight.iter().enumerate() {
            let wrong = if gone.contains(&k) { 4.0 + k as f64 } else { 0.0 };
            observer.observe(y + Vector2::new(wrong, -wrong), &[*a]);
        }
        apart(observer.estimate().unwrap(), truth(&flight))
    };
    for gone in [&[15][..], &[25], &[12, 13, 19], &[6, 20]] {
        let off = watch(&lost, gone);
        assert!(off < 1e-3, "lost in {gone:?}: off by {off}");
    }
    assert!(watch(&motion(0.0), &[25]) > 1.0, "the clean drawing loses no body");
}

#[test]
fn a_camera_that_shakes_more_than_the_encoder_says_is_averaged_out() {
    let mut rng = Noise::new(7).generator(Stream::Evaluation, 1);
    let lost = MotionModel { lost: true, ..motion(0.0) };
    let mut errors = [0.0; 2];
    for _ in 0..60 {
        let flight = flight(&lost, 25, 0.0, &mut rng);
        for (n, model) in [lost.clone(), motion(0.0)].into_iter().enumerate() {
            let mut observer = LatentObserver::new(model, 20);
            for (y, a) in &flight {
                let shake = Vector2::new(StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                observer.observe(y + shake * (10.0 * SCALE * FRAME_NOISE), &[*a]);
            }
            errors[n] += (observer.estimate().unwrap().v - truth(&flight).v).norm() / 60.0;
        }
    }
    assert!(3.0 * errors[0] < errors[1], "{errors:?}");
    assert!(errors[0] < SCALE * FRAME_NOISE, "{errors:?}");
}

#[test]
fn where_bodies_are_lost_two_frames_tell_of_a_wall() {
    let motion = MotionModel { lost: true, ..motion(0.0) };
    let mut observer = LatentObserver::new(motion.clone(), 20);
    let mut state = Vector4::new(-4.0, 0.0, 0.3, 0.0);
    for _ in 0..10 {
        state = motion.step(&state, Vector2::zeros()).0;
        observer.observe(state.fixed_rows::<2>(0).into_owned(), &[Vector2::zeros()]);
    }
    let wall = state.fixed_rows::<2>(0).into_owned();
    for _ in 0..4 {
        observer.observe(wall, &[Vector2::zeros()]);
    }
    let found = observer.estimate().unwrap();
    assert!(found.v.norm() < 1e-6 && (found.y - wall).norm() < 1e-6, "{found:?}");
}

#[test]
fn at_the_speed_limit_and_after_a_wall_it_is_right() {
    // Full thrust east: the limit is reached after twelve intervals.
    let motion = motion(0.0);
    let mut observer = LatentObserver::new(motion.clone(), 20);
    let mut state = Vector4::new(-4.0, 0.0, 0.0, 0.0);
    let a = Vector2::new(1.0, 0.0);
    observer.observe(Vector2::new(-4.0, 0.0), &[]);
    for k in 0..30 {
        state = motion.step(&state, a).0;
        let wobble = SCALE * FRAME_NOISE * (k as f64 * 2.1).sin();
        observer.observe(state.fixed_rows::<2>(0) + Vector2::new(wobble, -wobble), &[a]);
    }
    let v = observer.estimate().unwrap().v;
    assert!((v.norm() - motion.reach).abs() < 1e-3, "{v} at the limit {}", motion.reach);
    // A wall stops it: two frames later the speed is zero, however long the window.
    let y = state.fixed_rows::<2>(0).into_owned();
    for _ in 0..3 {
        observer.observe(y, &[Vector2::zeros()]);
    }
    let found = observer.estimate().unwrap();
    assert!(found.v.norm() < 3.0 * SCALE * FRAME_NOISE, "{found:?}");
}
