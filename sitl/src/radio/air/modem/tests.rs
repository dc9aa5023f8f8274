use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::radio::air::fading::Fading;
use crate::radio::air::rate::{FrameError, fsk_bit_error};
use crate::units::Snr;

fn preset(name: &str) -> AirRadio {
    AirRadio::named(name).unwrap()
}

fn air(radio: AirRadio, seed: u64) -> Air<u64> {
    Air::new(radio, seed, 0).unwrap()
}

fn at(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// Offers frames (time, way, kind, bytes) one after the other, and lets the radio end.
fn carry(air: &mut Air<u64>, frames: &[(f64, Way, u32, usize)]) -> Vec<CarriedFrame<u64>> {
    let mut out = Vec::new();
    for (k, &(time, way, kind, bytes)) in frames.iter().enumerate() {
        air.poll(at(time), |frame| out.push(frame));
        air.offer(at(time), way, kind, bytes, k as u64);
    }
    while let Some(next) = air.next_event() {
        air.poll(next, |frame| out.push(frame));
    }
    out
}

/// Frames of one kind down at a steady period.
fn stream(count: u32, period: f64, bytes: usize) -> Vec<(f64, Way, u32, usize)> {
    (0..count).map(|k| (f64::from(k) * period, Way::Down, 30, bytes)).collect()
}

fn share(frames: &[CarriedFrame<u64>], fate: FrameFate) -> f64 {
    frames.iter().filter(|frame| frame.fate == fate).count() as f64 / frames.len() as f64
}

/// Within 2 %.
#[track_caller]
fn near(measured: f64, expected: f64, what: &str) {
    assert!((measured / expected - 1.0).abs() < 0.02, "{what}: {measured}, expected {expected}");
}

#[test]
fn the_perfect_radio_takes_no_time_and_loses_nothing() {
    let frames: Vec<_> =
        (0..2000).map(|k| (f64::from(k) * 1e-5, Way::BOTH[k as usize % 2], 0, 280)).collect();
    let out = carry(&mut air(preset("perfect"), 0), &frames);
    assert_eq!(out.len(), 2000);
    assert!(out.iter().zip(0..).all(|(frame, k)| frame.frame == k && frame.fate == FrameFate::Arrived));
    assert!(out.iter().all(|frame| frame.delay().is_zero()));
}

/// The density of the Rician power with mean 1, (1 + K) e^(-K - (1 + K) x) I0(2 √(K (1 + K) x)).
fn rician(k: f64, x: f64) -> f64 {
    let z = 2.0 * (k * (1.0 + k) * x).sqrt();
    // I0 by its integral, times e^-z so that nothing overflows.
    let steps = 200;
    let angle = |n: i32| std::f64::consts::PI * (f64::from(n) + 0.5) / f64::from(steps);
    let bessel: f64 = (0..steps).map(|n| (z * (angle(n).cos() - 1.0)).exp()).sum::<f64>() / f64::from(steps);
    (1.0 + k) * (z - k - (1.0 + k) * x).exp() * bessel
}

/// The mean of 1 - (1 - P_b)^n over the Rician power, by Simpson's rule.
fn expected_loss(snr_db: f64, k: f64, bits: f64) -> f64 {
    let (steps, top) = (4000, 8.0);
    let h = top / f64::from(steps);
    let at = |n: i32| {
        let x = f64::from(n) * h;
        let loss = 1.0 - (1.0 - fsk_bit_error(Snr::from_db(snr_db).0 * x)).powf(bits);
        loss * rician(k, x)
    };
    let weight = |n: i32| if n == 0 || n == steps { 1.0 } else { f64::from(2 + 2 * (n % 2)) };
    (0..=steps).map(|n| weight(n) * at(n)).sum::<f64>() * h / 3.0
}

/// A 3DR-like stream: kind, bytes, period in s. The periods share no multiple with the round of the windows.
const TELEMETRY: [(u32, usize, f64); 5] =
    [(0, 21, 1.003), (1, 43, 0.501), (30, 40, 0.2501), (33, 40, 0.2503), (74, 32, 0.2507)];

fn telemetry(seconds: f64) -> Vec<(f64, Way, u32, usize)> {
    let mut frames: Vec<_> = TELEMETRY
        .iter()
        .flat_map(|&(kind, bytes, period)| {
            (0..(seconds / period) as u32).map(move |k| (f64::from(k) * period, Way::Down, kind, bytes))
        })
        .collect();
    frames.sort_by(|a, b| a.0.total_cmp(&b.0));
    frames
}

#[test]
fn sik_57_loses_by_range_as_bit_errors_under_rician_fading_say() {
    let radio = preset("sik-57");
    let still = AirChannel::new(AirRadio { fading: Fading::None, ..radio.clone() }, 0, 0).unwrap();
    let frames = telemetry(20_000.0);
    let mut losses = Vec::new();
    for range_m in [8e3, 12e3, 16e3, 20e3, 26e3] {
        let place = [range_m, 0.0, 100.0];
        let mut air = air(radio.clone(), 7);
        air.set_place(place);
        let out = carry(&mut air, &frames);
        assert_eq!(out.len(), frames.len());
        let snr_db = still.budget(Way::Down, Vector3::from(place), 0).snr_db();
        let k = radio.fading.factor((98.7 / range_m).atan()).unwrap();
        // Frames that share a packet share its fate, so the length of the packet counts.
        let mut packets = BTreeMap::<Duration, usize>::new();
        out.iter().for_each(|frame| *packets.entry(frame.on_air.unwrap()).or_default() += frame.bytes);
        let mut known = BTreeMap::new();
        let mut sum = 0.0;
        for frame in &out {
            let bytes = packets[&frame.on_air.unwrap()];
            let bits = 8.0 * (bytes + 4) as f64;
            sum += *known.entry(bytes).or_insert_with(|| expected_loss(snr_db, k, bits));
        }
        let (measured, expected) = (1.0 - share(&out, FrameFate::Arrived), sum / out.len() as f64);
        println!("sik-57 at {range_m} m: SNR {snr_db:.2} dB, lost {measured:.4}, expected {expected:.4}");
        near(1.0 - measured, 1.0 - expected, "arrived");
        if expected > 0.05 {
            near(measured, expected, "lost");
        }
        losses.push(expected);
    }
    assert!(losses[0] < 0.05 && losses[4] > 0.5, "the ranges cover the edge: {losses:?}");
}

/// W, T, and the time of 40 bytes on the air of sik-57, s.
const SIK: [f64; 3] = [0.113_376, 0.235_072, 0.00208 + 44.0 * 8.0 / 64e3];

#[test]
fn sik_57_delays_a_frame_by_window_air_and_wire() {
    let [window, round, air_time] = SIK;
    let mut air = air(preset("sik-57"), 1);
    air.set_place([100.0, 0.0, 100.0]);
    let out = carry(&mut air, &stream(20_000, 0.260_1, 40));
    // A frame that comes at any phase waits for (T - (W - a))² / 2 T on average.
    let wait = (round - (window - air_time)).powi(2) / (2.0 * round);
    let expected = wait + air_time + 2.0 * 400.0 / 57_600.0;
    let mean = out.iter().map(|frame| frame.delay().as_secs_f64()).sum::<f64>() / out.len() as f64;
    println!("sik-57, 40 bytes: mean delay {:.2} ms, expected {:.2} ms", 1e3 * mean, 1e3 * expected);
    near(mean, expected, "mean delay");
    let longest = out.iter().map(CarriedFrame::delay).max().unwrap().as_secs_f64();
    near(longest, expected - wait + round - (window - air_time), "longest delay");
}

#[test]
fn sik_57_carries_what_fits_in_its_windows_and_drops_the_rest() {
    let [window, round, air_time] = SIK;
    let mut air = air(preset("sik-57"), 1);
    air.set_place([100.0, 0.0, 100.0]);
    let seconds = 250.0;
    let out = carry(&mut air, &stream(100_000, seconds / 100_000.0, 40));
    // Packets of as many frames of 40 bytes as fit in 248 bytes and in the rest of the window.
    let (mut a_window, mut left) = (0.0, window);
    while left >= air_time {
        let frames = ((left - 0.00208) / (8.0 / 64e3) - 4.0).min(248.0) / 40.0;
        a_window += frames.floor();
        left -= 0.00208 + (40.0 * frames.floor() + 4.0) * 8.0 / 64e3 + 0.00208;
    }
    let expected = a_window * 40.0 / round;
    let arrived = out.iter().filter(|frame| frame.fate == FrameFate::Arrived).count() as f64;
    let measured = arrived * 40.0 / seconds;
    println!("sik-57, saturated: {measured:.0} bytes/s, expected {expected:.0}");
    near(measured, expected, "throughput");
    near(share(&out, FrameFate::QueueFull), 1.0 - expected / (40.0 * 400.0), "dropped");
    // A full queue of 2048 bytes goes on in so many windows.
    let waits = out.iter().filter(|f| f.fate == FrameFate::Arrived).map(|f| f.delay().as_secs_f64());
    let (late, count) = waits.skip(1000).fold((0.0, 0), |(sum, n), wait| (sum + wait, n + 1));
    near(late / f64::from(count), 51.0 * 40.0 / expected + 2.0 * 400.0 / 57_600.0, "delay with a full queue");
}

#[test]
fn each_end_of_a_half_duplex_radio_keeps_to_its_windows() {
    for name in ["sik-57", "sik-64k-915", "elrs-mavlink"] {
        let radio = preset(name);
        let Duplex::Slots { up_s, down_s, guard_s } = radio.duplex else { panic!("{name} has slots") };
        let mut air = air(radio, 3);
        air.set_place([500.0, 0.0, 100.0]);
        let frames: Vec<_> =
            (0..2000).map(|k| (f64::from(k) * 0.0213, Way::BOTH[k as usize % 2], k % 7, 10)).collect();
        let out = carry(&mut air, &frames);
        let [up, down, guard] = [up_s, down_s, guard_s].map(|s| (s * 1e9).round() as u128);
        for frame in out.iter().filter(|frame| frame.packets == 1) {
            let phase = frame.on_air.unwrap().as_nanos() % (up + down + 2 * guard);
            let (start, end) = if frame.way == Way::Up { (0, up) } else { (up + guard, up + guard + down) };
            let good = phase >= start && phase + frame.air_time.as_nanos() <= end;
            assert!(good, "{name}: {} at {phase} ns", frame.way.name());
        }
        assert!(share(&out, FrameFate::Arrived) > 0.99, "{name}");
    }
}

#[test]
fn on_a_shared_air_one_sends_at_a_time() {
    let mut radio = preset("wifi");
    (radio.up.error, radio.down.error) = (FrameError::None, FrameError::None);
    let mut air = air(radio, 3);
    air.set_place([50.0, 0.0, 20.0]);
    let frames: Vec<_> =
        (0..1000).map(|k| (f64::from(k) * 1e-4, Way::BOTH[k as usize % 2], 0, 200)).collect();
    let out = carry(&mut air, &frames);
    let mut times: Vec<_> = out.iter().map(|f| (f.on_air.unwrap(), f.on_air.unwrap() + f.air_time)).collect();
    times.sort_unstable();
    let overlap = times.windows(2).find(|pair| pair[0].1 > pair[1].0);
    assert!(overlap.is_none(), "{overlap:?}");
    assert_eq!(share(&out, FrameFate::Arrived), 1.0);
}

/// A radio that loses half of all packets, whatever the place.
fn half() -> AirRadio {
    let text = "extends = \"perfect\"\n[down]\nrate = { model = \"fixed\", bps = 1e6, snr_db = 128 }\n\
                error = { model = \"waterfall\", per = 0.5, width_db = 1e9 }\n";
    AirRadio::parse(text, "half").unwrap()
}

#[test]
fn repetition_makes_loss_rare_and_delay_long() {
    let frames = stream(20_000, 0.02, 25);
    for retries in [0, 1, 3] {
        let mut radio = half();
        (radio.down.retries, radio.down.retry_s) = (retries, 0.003);
        let out = carry(&mut air(radio, 5), &frames);
        let lost = 1.0 - share(&out, FrameFate::Arrived);
        let expected = 0.5f64.powi(retries as i32 + 1);
        // Four standard deviations of a share.
        let spread = 4.0 * (expected * (1.0 - expected) / 20_000.0).sqrt();
        assert!((lost - expected).abs() < spread, "{retries}: {lost}");
        let longest = out.iter().map(CarriedFrame::delay).max().unwrap();
        let by_hand = 200e-6 + f64::from(retries) * (200e-6 + 3e-3);
        assert!((longest.as_secs_f64() - by_hand).abs() < 1e-8, "{longest:?}");
    }
}

#[test]
fn a_long_frame_arrives_if_all_its_packets_do() {
    let mut radio = half();
    radio.down.packet_bytes = 10;
    let out = carry(&mut air(radio, 5), &stream(20_000, 0.02, 25));
    let arrived = share(&out, FrameFate::Arrived);
    assert!((arrived - 0.125).abs() < 4.0 * (0.125f64 * 0.875 / 20_000.0).sqrt(), "{arrived}");
    assert!(out.iter().filter(|f| f.fate == FrameFate::Arrived).all(|frame| frame.packets == 3));
}

#[test]
fn jitter_has_its_mean_and_lets_nothing_overtake() {
    let mut radio = preset("perfect");
    (radio.down.latency_s, radio.down.jitter_s) = (0.1, 0.02);
    let frames = stream(20_000, 1.0, 25);
    let out = carry(&mut air(radio.clone(), 5), &frames);
    let mean = out.iter().map(|frame| frame.delay().as_secs_f64()).sum::<f64>() / 20_000.0;
    near(mean, 0.12, "mean delay");
    let out = carry(&mut air(radio, 5), &stream(1000, 0.001, 25));
    assert!(out.iter().zip(0..).all(|(frame, k)| frame.frame == k));
    assert!(out.windows(2).all(|pair| pair[0].done <= pair[1].done));
}

#[test]
fn the_paper_s_gate_shuts_for_a_whole_interval() {
    let mut air = air(preset("paper"), 0);
    // In Scenario 2's shadow at low power there is an outage; beside it there is none.
    air.set_place([450.0, 250.0, 100.0]);
    let dark = carry(&mut air, &stream(50, 0.1, 40));
    assert_eq!(share(&dark, FrameFate::Outage), 1.0);
    air.set_place([250.0, 50.0, 100.0]);
    let bright = carry(&mut air, &[(100.0, Way::Up, 84, 280)]);
    assert_eq!((bright[0].fate, bright[0].delay()), (FrameFate::Arrived, Duration::ZERO));
}

#[test]
fn a_heartbeat_more_changes_the_fate_of_no_other_frame() {
    let mut radio = half();
    radio.down.rate = crate::radio::air::rate::AirRate::Unlimited;
    // Unlimited rates need no SNR, so the chance is one half all the same.
    let plain = stream(500, 0.013, 40);
    let mut more = plain.clone();
    more.extend((0..60).map(|k| (f64::from(k) * 0.1, Way::Down, 0, 21)));
    more.sort_by(|a, b| a.0.total_cmp(&b.0));
    let fates = |frames: &[(f64, Way, u32, usize)]| -> Vec<_> {
        let out = carry(&mut air(radio.clone(), 9), frames);
        out.into_iter().filter(|f| f.kind == 30).map(|f| (f.offered, f.fate)).collect()
    };
    assert_eq!(fates(&plain), fates(&more));
}

#[test]
fn the_report_tells_room_and_counts() {
    let mut air = air(preset("sik-57"), 1);
    air.set_place([100.0, 0.0, 100.0]);
    for k in 0..60 {
        air.offer(Duration::ZERO, Way::Down, 30, 40, k);
    }
    let report = air.report(Duration::ZERO, Way::Down);
    assert!(report.room < 0.01, "{report:?}");
    let mut out = Vec::new();
    air.poll(at(10.0), |frame| out.push(frame));
    let report = air.report(at(10.0), Way::Down);
    assert_eq!((report.room, report.arrived, report.arrived_bytes, report.lost), (1.0, 51, 2040, 9));
    assert!(report.budget.snr_db() > 20.0);
}

proptest! {
    /// How often it is polled changes nothing, and the same seed gives the same fates.
    #[test]
    fn when_it_is_polled_changes_nothing(seed in 0u64..50, steps in prop::collection::vec(0.0f64..0.05, 1..40)) {
        for name in ["sik-57", "elrs-mavlink", "wifi", "lte", "satellite", "paper"] {
            let mut plain = air(preset(name), seed);
            plain.set_place([9000.0, 400.0, 90.0]);
            let mut time = 0.0;
            let frames: Vec<_> = steps.iter().enumerate().map(|(k, step)| {
                time += step;
                (time, Way::BOTH[k % 2], k as u32 % 3, 12 + 7 * k)
            }).collect();
            let expected = carry(&mut plain, &frames);
            prop_assert_eq!(expected.len(), frames.len());
            prop_assert!(expected.windows(2).all(|pair| pair[0].done <= pair[1].done));
            let mut often = air(preset(name), seed);
            often.set_place([9000.0, 400.0, 90.0]);
            let (mut out, mut next) = (Vec::new(), 0);
            for tick in 0..20_000 {
                let now = f64::from(tick) * 1e-3;
                while let Some(&(time, way, kind, bytes)) = frames.get(next).filter(|frame| frame.0 <= now) {
                    often.poll(at(time), |frame| out.push(frame));
                    often.offer(at(time), way, kind, bytes, next as u64);
                    next += 1;
                }
                often.poll(at(now), |frame| out.push(frame));
            }
            prop_assert_eq!(out, expected);
        }
    }
}
