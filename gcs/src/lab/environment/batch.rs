//! Many flights that are stepped in one call, each with a seed of its own.

use crpl_sitl::Scenario;
use crpl_sitl::sim::metric::FlightScore;
use rayon::prelude::*;

use super::{ACTION, FlightView, OpenFlight, ShownNumber, Transition};

/// What follows the end of a flight in a batch, as Gymnasium names it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Autoreset {
    /// The step after it begins the next flight; its action is not flown.
    NextStep,
    /// The same step begins the next flight, and what the old one showed last is kept.
    SameStep,
    /// Nothing: further steps of this flight change nothing.
    Disabled,
}

/// What one step of one flight has brought; zeros in a step that begins a flight, or after its end.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepReport {
    /// See [`super::Transition::reward`].
    pub reward: f64,
    /// See [`super::Transition::terminated`].
    pub terminated: bool,
    /// See [`super::Transition::truncated`].
    pub truncated: bool,
    /// Whether an interval was flown.
    pub flown: bool,
    /// SNR, dB.
    pub snr_db: f32,
    /// Whether the interval was an outage.
    pub outage: bool,
    /// Collision probability at the interval's end.
    pub p_coll: f64,
    /// Whether it touched an obstacle.
    pub collided: bool,
}

impl From<&Transition> for StepReport {
    fn from(transition: &Transition) -> Self {
        let Transition { reward, terminated, truncated, record } = transition;
        Self {
            reward: *reward,
            terminated: *terminated,
            truncated: *truncated,
            flown: true,
            snr_db: record.snr_db,
            outage: record.outage,
            p_coll: record.p_coll,
            collided: record.collided,
        }
    }
}

/// A place in a batch.
#[derive(Debug, Clone)]
struct FlightSlot {
    flight: OpenFlight,
    seed: u64,
    is_over: bool,
    score: Option<FlightScore>,
}

impl FlightSlot {
    fn new(scenario: &Scenario, view: &FlightView, seed: u64) -> Self {
        Self { flight: OpenFlight::new(scenario, view, seed), seed, is_over: false, score: None }
    }
}

/// Flights side by side.
#[derive(Debug, Clone)]
pub struct FlightBatch {
    scenario: Scenario,
    view: FlightView,
    autoreset: Autoreset,
    slots: Vec<FlightSlot>,
}

impl FlightBatch {
    /// Flights with these seeds, at tick 0. `scenario` must have passed [`Scenario::check`].
    #[must_use]
    pub fn new(scenario: Scenario, view: FlightView, autoreset: Autoreset, seeds: &[u64]) -> Self {
        let slots = seeds.iter().map(|seed| FlightSlot::new(&scenario, &view, *seed)).collect();
        Self { scenario, view, autoreset, slots }
    }

    /// The world of all flights.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// What they show.
    #[must_use]
    pub fn view(&self) -> &FlightView {
        &self.view
    }

    /// Number of flights.
    #[must_use]
    pub fn count(&self) -> usize {
        self.slots.len()
    }

    /// A flight; the next one where it has ended and [`Autoreset::SameStep`] holds.
    #[must_use]
    pub fn flight(&self, index: usize) -> Option<&OpenFlight> {
        self.slots.get(index).map(|slot| &slot.flight)
    }

    /// Seed of a flight.
    #[must_use]
    pub fn seed(&self, index: usize) -> Option<u64> {
        self.slots.get(index).map(|slot| slot.seed)
    }

    /// The metrics of the flight that ended last in this place; `None` before the first end.
    #[must_use]
    pub fn score(&self, index: usize) -> Option<&FlightScore> {
        self.slots.get(index)?.score.as_ref()
    }

    /// Begins a flight anew.
    pub fn reset(&mut self, index: usize, seed: u64) {
        if let Some(slot) = self.slots.get_mut(index) {
            *slot = FlightSlot::new(&self.scenario, &self.view, seed);
        }
    }

    /// Writes what every flight shows now, [`FlightView::width`] values each.
    pub fn show<T: ShownNumber>(&self, now: &mut [T]) {
        let width = self.view.width(&self.scenario);
        self.slots.iter().zip(now.chunks_exact_mut(width)).for_each(|(slot, out)| T::show(&slot.flight, out));
    }

    /// One interval of every flight. `actions` holds [`ACTION`] numbers a flight, `now` takes what the flights show
    /// then, and `last` what those that end in this step showed at their end, the others' part left as it is. A flight
    /// beyond any of the buffers is not flown. `parallel`: on the threads of the rayon pool that calls.
    pub fn step<T: ShownNumber>(
        &mut self,
        actions: &[f32],
        reports: &mut [StepReport],
        now: &mut [T],
        last: Option<&mut [T]>,
        parallel: bool,
    ) {
        let Self { scenario, view, autoreset, slots } = self;
        let (width, seeds) = (view.width(scenario), slots.len() as u64);
        let lasts: Vec<Option<&mut [T]>> = match last {
            Some(last) => last.chunks_exact_mut(width).map(Some).collect(),
            None => slots.iter().map(|_| None).collect(),
        };
        let places = slots.iter_mut().zip(reports).zip(actions.chunks_exact(ACTION));
        let buffers = now.chunks_exact_mut(width).zip(lasts);
        let step =
            |((slot, report), action): ((&mut FlightSlot, &mut StepReport), &[f32]), now: &mut [T], last| {
                let begin = |seed: u64| FlightSlot::new(scenario, view, seed.wrapping_add(seeds));
                *report = slot.step(*autoreset, begin, action, last);
                T::show(&slot.flight, now);
            };
        if parallel {
            let all: Vec<_> = places.zip(buffers).collect();
            all.into_par_iter().for_each(|(place, (now, last))| step(place, now, last));
        } else {
            places.zip(buffers).for_each(|(place, (now, last))| step(place, now, last));
        }
    }
}

impl FlightSlot {
    fn step<T: ShownNumber>(
        &mut self,
        autoreset: Autoreset,
        begin: impl Fn(u64) -> Self,
        action: &[f32],
        last: Option<&mut [T]>,
    ) -> StepReport {
        if self.is_over {
            if autoreset == Autoreset::NextStep {
                *self = Self { score: self.score, ..begin(self.seed) };
            }
            return StepReport::default();
        }
        let transition =
            self.flight.step(std::array::from_fn(|n| action.get(n).copied().unwrap_or_default()));
        if transition.terminated || transition.truncated {
            self.is_over = true;
            self.score = self.flight.score();
            if autoreset == Autoreset::SameStep {
                if let Some(last) = last {
                    T::show(&self.flight, last);
                }
                *self = Self { score: self.score, ..begin(self.seed) };
            }
        }
        StepReport::from(&transition)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EAST: [f32; 6] = [1.0, 0.0, 1.0, 0.5, 0.5, -1.0];

    fn batch(autoreset: Autoreset) -> FlightBatch {
        let mut scenario = Scenario { horizon: 3, ..Scenario::default() };
        scenario.disturbance.sigma_c = 0.005;
        FlightBatch::new(scenario, FlightView::State, autoreset, &[4, 5])
    }

    fn step(batch: &mut FlightBatch, parallel: bool) -> (Vec<StepReport>, Vec<f32>, Vec<f32>) {
        let width = batch.view().width(batch.scenario());
        let mut reports = vec![StepReport::default(); 2];
        let (mut now, mut last) = (vec![0.0f32; 2 * width], vec![-1.0; 2 * width]);
        batch.step(&EAST, &mut reports, &mut now, Some(&mut last), parallel);
        (reports, now, last)
    }

    #[test]
    fn a_batch_flies_what_each_flight_flies_alone_on_one_thread_or_many() {
        for parallel in [false, true] {
            let mut flights = batch(Autoreset::Disabled);
            let mut alone = OpenFlight::new(flights.scenario(), &FlightView::State, 5);
            for _ in 0..3 {
                let (reports, now, _) = step(&mut flights, parallel);
                let transition = alone.step([0.5, 0.5, -1.0]);
                assert_eq!(
                    (reports[1].reward, reports[1].p_coll),
                    (transition.reward, transition.record.p_coll)
                );
                let mut shown = vec![0.0f32; now.len() / 2];
                f32::show(&alone, &mut shown);
                assert_eq!(shown, now[now.len() / 2..]);
            }
            assert_eq!(flights.flight(1).unwrap().records(), alone.records());
        }
    }

    #[test]
    fn the_next_flight_begins_in_the_next_step_with_the_next_seed() {
        let mut flights = batch(Autoreset::NextStep);
        let ends: Vec<_> = (0..3).map(|_| step(&mut flights, false).0[0]).collect();
        assert!(!ends[1].truncated && ends[2].truncated && ends[2].flown);
        assert_eq!([flights.seed(0), flights.seed(1)], [Some(4), Some(5)]);
        let ended = flights.score(0).copied();
        let (reports, now, _) = step(&mut flights, false);
        assert_eq!(reports[0], StepReport::default());
        assert_eq!([flights.seed(0), flights.seed(1)], [Some(6), Some(7)]);
        assert_eq!((now[7], flights.score(0).copied()), (0.0, ended));
        assert!(step(&mut flights, false).0[0].flown);
    }

    #[test]
    fn the_next_flight_begins_in_the_same_step_and_the_last_view_is_kept() {
        let mut flights = batch(Autoreset::SameStep);
        assert!(step(&mut flights, false).2.iter().all(|x| *x == -1.0));
        step(&mut flights, false);
        let (reports, now, last) = step(&mut flights, false);
        assert!(reports[0].truncated && reports[0].flown);
        assert_eq!([now[7], last[7]], [0.0, 1.0]);
        assert_eq!((flights.seed(1), flights.score(1).unwrap().ticks), (Some(7), 3));
    }

    #[test]
    fn without_a_reset_a_flight_that_is_over_stays_so_until_it_is_begun_anew() {
        let mut flights = batch(Autoreset::Disabled);
        (0..3).for_each(|_| drop(step(&mut flights, false)));
        let before = flights.flight(0).unwrap().records().to_vec();
        assert!(!step(&mut flights, false).0[0].flown);
        assert_eq!(flights.flight(0).unwrap().records(), before);
        flights.reset(0, 9);
        assert!(step(&mut flights, false).0[0].flown && flights.seed(0) == Some(9));
    }
}
