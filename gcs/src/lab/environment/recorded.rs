//! An open flight as an episode of a recording, as `gcs record` writes them.

use crpl_model::world_model::recording::{RecordedEpisode, Step, Truth};
use crpl_sitl::camera::Frame;
use nalgebra::Vector2;

use super::OpenFlight;

impl OpenFlight {
    /// The flight so far with its pictures, those of the ticks from 0 on: what training may see, and the truth. Pictures
    /// beyond the flight are left out.
    #[must_use]
    pub fn recorded(&self, mut frames: Vec<Frame>) -> (RecordedEpisode, Truth) {
        let scenario = self.sim().scenario();
        let records = self.records();
        frames.truncate(records.len() + 1);
        let step = |k: usize| {
            let (before, after) = (k.checked_sub(1).map(|k| &records[k]), records.get(k));
            Step {
                time_s: k as f64 * scenario.scale.interval_s,
                // The radio measured at the interval's beginning, where the picture was taken.
                snr_db: after.map_or(f32::NAN, |record| record.snr_db),
                power: after.or(before).map_or(1.0, |record| record.power.level() as f32),
                outage: before.is_some_and(|record| record.outage),
                contact: before.is_some_and(|record| record.collided),
            }
        };
        let share = |a: f64| a.clamp(-1.0, 1.0) as f32;
        let last = frames.len().saturating_sub(1);
        let mut steps: Vec<Step> = (0..frames.len()).map(step).collect();
        if let Some(step) = steps.last_mut() {
            step.snr_db = f32::NAN;
        }
        let episode = RecordedEpisode {
            actions: records[..last].iter().map(|record| record.flown.map(share)).collect(),
            steps,
            frames,
            a_max: scenario.dynamics.a_max,
            base_station: Some(scenario.channel.base_station),
        };
        let first = scenario.obstacles.first().map(|obstacle| obstacle.position);
        let obstacles = records[..last].iter().filter_map(|record| record.obstacles.first().copied());
        let truth = Truth {
            uav: std::iter::once(scenario.start).chain(records[..last].iter().map(|r| r.r_next)).collect(),
            obstacle: first.into_iter().chain(obstacles).collect::<Vec<Vector2<f64>>>(),
        };
        (episode, truth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Crew;
    use crate::lab::environment::{FlightView, PICTURE, ShownNumber};
    use crate::lab::record::folder::RecordingFolder;
    use crate::lab::record::recorder::{Recorder, RecordingPlan};
    use crpl_model::world_model::recording::{Recording, RecordingFormat};
    use crpl_sitl::units::TxPower;
    use crpl_sitl::{Scenario, Sim};

    #[test]
    fn an_episode_is_what_the_recorder_writes_of_the_same_flight() {
        let dir = tempfile::tempdir().unwrap();
        let scenario = Scenario::named("demo").unwrap();
        let plan = RecordingPlan { episodes: 1, pictures: 40, seed: 3, format: RecordingFormat::default() };
        let folder = RecordingFolder::claim(dir.path(), false, false).unwrap();
        let mut recorder = Recorder::new(&scenario, plan, folder);
        let mut sim = Sim::new(scenario.clone(), 5);
        let mut flight = OpenFlight::new(&scenario, &FlightView::Picture, 5);
        let mut frames = Vec::new();
        recorder.begin().unwrap();
        while !recorder.is_done() {
            let mut bytes = vec![0u8; PICTURE];
            u8::show(&flight, &mut bytes);
            frames.push(Frame::from_rgb(bytes).unwrap());
            let command = recorder.command(&sim.percept());
            recorder.sent();
            sim.handle(command);
            sim.advance();
            let a = scenario.scale.paper_from_ned_acceleration(command.accel) / scenario.dynamics.a_max;
            let power = if command.power == TxPower::High { 1.0 } else { -1.0 };
            flight.step([a.x as f32, a.y as f32, power]);
        }
        let recording = Recording::open(dir.path(), None).unwrap();
        let written = &recording.episodes()[0];
        let (episode, truth) = flight.recorded(frames);
        let pictures: Vec<Frame> = (0..40).map(|k| written.frame(k).unwrap()).collect();
        assert!(episode.frames == pictures);
        let off =
            episode.actions.iter().zip(&written.actions).map(|(a, b)| (a - b).amax()).fold(0.0, f32::max);
        assert!(off < 1e-6 && episode.actions.len() == written.actions.len(), "{off}");
        for (ours, theirs) in episode.steps.iter().zip(&written.steps) {
            // The last picture has no measurement.
            let key = |s: &Step| (s.time_s, s.outage, s.contact, s.snr_db.is_nan());
            assert_eq!(key(ours), key(theirs));
            assert!(ours.snr_db.is_nan() || (ours.snr_db - theirs.snr_db).abs() < 1e-4);
        }
        assert_eq!(episode.base_station, written.base_station);
        let known = Truth::load(dir.path(), 0).unwrap();
        assert!(truth.uav.iter().zip(&known.uav).all(|(a, b)| (a - b).norm() < 1e-6));
        assert_eq!(truth.obstacle.len(), known.obstacle.len());
    }
}
