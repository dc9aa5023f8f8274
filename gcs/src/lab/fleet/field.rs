//! The field and the bandwidth that vehicles of one base station share: who is in the air, who got through, who
//! collided, who has landed. Does not know who commands them.

use crpl_model::world_model::StationHeads;
use crpl_sitl::radio::message::Command;
use crpl_sitl::units::TxPower;
use crpl_sitl::world::channel;
use crpl_sitl::world::dynamics::State;
use crpl_sitl::world::obstacles::Obstacles;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

use super::FleetPlan;
use super::scheduler::{SharedRadio, SlotRequest};
use super::separation::Separation;
use crate::station::belief::Latents;

/// Intervals at its goal after which a vehicle lands (our choice).
const LANDS: u64 = 5;
/// How far ahead an outage is predicted, intervals (our choice).
const AHEAD: u32 = 15;

/// What flies in a fleet.
pub trait FleetCraft {
    /// Its vehicle.
    fn sim(&self) -> &Sim;
    /// The same, to be flown.
    fn sim_mut(&mut self) -> &mut Sim;
}

/// A vehicle of a fleet.
#[derive(Debug, Clone)]
pub struct FleetMember<C> {
    /// What flies.
    pub craft: C,
    /// The turn in which it leaves.
    pub leaves: u64,
    /// Whether it flies the other way, in the mirror image.
    pub mirrored: bool,
    /// Intervals at the goal in a row.
    at_goal: u64,
    /// Whether it has left the field.
    pub landed: bool,
    /// Intervals since a command last got through.
    waited: u64,
}

/// Why a vehicle leaves the field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FleetLanding {
    /// It has stayed at its goal.
    AtGoal,
    /// Its horizon is over.
    OutOfTime,
    /// It has collided and fallen.
    Fell,
}

/// x is seen from the other side.
fn mirror(v: Vector2<f64>, about: f64) -> Vector2<f64> {
    Vector2::new(about - v.x, v.y)
}

impl<C: FleetCraft> FleetMember<C> {
    /// Whether it flies in this turn.
    #[must_use]
    pub fn is_airborne(&self, turn: u64) -> bool {
        turn >= self.leaves && !self.landed
    }

    /// Where it says it is, in the common frame.
    fn reported(&self) -> State {
        let sim = self.craft.sim();
        let (report, scale) = (sim.telemetry(), sim.scenario().scale);
        let r = scale.paper_from_ned(report.position);
        let v = scale.paper_from_ned_velocity(report.velocity);
        self.own(&State { r, v })
    }

    /// A state of the common frame in its own, and back.
    fn own(&self, state: &State) -> State {
        match self.mirrored {
            true => State { r: mirror(state.r, 1.0), v: mirror(state.v, 0.0) },
            false => *state,
        }
    }

    /// A direction of the common frame in its own, and back.
    fn turned(&self, a: Vector2<f64>) -> Vector2<f64> {
        if self.mirrored { mirror(a, 0.0) } else { a }
    }
}

/// A field with a fleet in it.
#[derive(Debug, Clone)]
pub struct FleetField<C> {
    plan: FleetPlan,
    scenario: Scenario,
    /// The radio of all.
    pub radio: SharedRadio,
    /// All vehicles, those that wait and those that have landed among them.
    pub members: Vec<FleetMember<C>>,
    touching: Vec<(usize, usize)>,
    powers: Vec<f64>,
    /// How often two vehicles collided: entries, not intervals.
    pub collisions: u64,
    /// Least distance of two vehicles' centres, units; infinite of one.
    pub nearest: f64,
}

impl<C: FleetCraft> FleetField<C> {
    /// A fleet before its first turn. `craft` makes a vehicle with the seed that it is given.
    #[must_use]
    pub fn new(scenario: &Scenario, plan: &FleetPlan, seed: u64, craft: impl Fn(u64) -> C) -> Self {
        let member = |n: usize| FleetMember {
            craft: craft(seed.wrapping_mul(1000).wrapping_add(n as u64)),
            leaves: plan.headway * (n as u64 / 2),
            mirrored: n % 2 == 1,
            at_goal: 0,
            landed: false,
            waited: 0,
        };
        let radio = SharedRadio {
            b_dt: plan.b_dt,
            packet_bits: scenario.radio.packet_bits,
            noise_power: scenario.channel.noise_power,
        };
        Self {
            plan: *plan,
            scenario: scenario.clone(),
            radio,
            members: (0..plan.vehicles).map(member).collect(),
            touching: Vec::new(),
            powers: Vec::new(),
            collisions: 0,
            nearest: f64::INFINITY,
        }
    }

    /// What its vehicles fly in.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// How it flies.
    #[must_use]
    pub fn plan(&self) -> &FleetPlan {
        &self.plan
    }

    /// Mean power level of the slots so far.
    #[must_use]
    pub fn mean_power(&self) -> f64 {
        self.powers.iter().sum::<f64>() / self.powers.len().max(1) as f64
    }

    /// Who flies in this turn.
    #[must_use]
    pub fn airborne(&self, turn: u64) -> Vec<usize> {
        (0..self.members.len()).filter(|n| self.members[*n].is_airborne(turn)).collect()
    }

    /// Whether all have landed.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.members.iter().all(|member| member.landed)
    }

    /// Where all say they are, in the common frame.
    #[must_use]
    pub fn states(&self) -> Vec<State> {
        self.members.iter().map(FleetMember::reported).collect()
    }

    /// Where the others of `airborne` are, as vehicle `n` sees them.
    #[must_use]
    pub fn others(&self, n: usize, airborne: &[usize], states: &[State]) -> Vec<State> {
        airborne.iter().filter(|k| **k != n).map(|k| self.members[n].own(&states[*k])).collect()
    }

    /// The command of vehicle `n`, or where they are to keep clear of each other, the nearest one that does.
    #[must_use]
    pub fn clear_command(&self, n: usize, command: Command, airborne: &[usize], states: &[State]) -> Command {
        if !self.plan.separate {
            return command;
        }
        let member = &self.members[n];
        let others: Vec<State> = airborne.iter().filter(|k| **k != n).map(|k| states[*k]).collect();
        let (scale, a_max) = (&self.scenario.scale, self.scenario.dynamics.a_max);
        let wish = member.turned(scale.paper_from_ned_acceleration(command.accel) / a_max);
        // The obstacles are the scenario's, and a mirrored vehicle's are mirrored.
        let reported = member.craft.sim().telemetry().obstacles(scale);
        let obstacles: Obstacles =
            reported.iter().map(|r| if member.mirrored { mirror(*r, 1.0) } else { *r }).collect();
        let flown = Separation::of(&self.scenario).of_wish(states[n], wish, &others, &obstacles);
        if flown == wish {
            return command;
        }
        let accel = scale.ned_from_paper_acceleration(a_max * member.turned(flown));
        Command { accel, ..command }
    }

    /// What vehicle `n` asks of the scheduler: with `heads`, its gain as the channel head predicts it straight on from
    /// where its latents are; without, nothing is known of its gain.
    #[must_use]
    pub fn request(
        &self,
        n: usize,
        power: TxPower,
        airborne: usize,
        predictor: Option<(&StationHeads, &Latents)>,
    ) -> SlotRequest {
        let waited = self.members[n].waited;
        let Some((heads, now)) = predictor else {
            return SlotRequest { vehicle: n, gain: 1.0, outage_in: None, waited, power };
        };
        let gain = |j: u32| {
            let at = |i: usize| now.y_c[i] + j as f32 * (now.y_c[i] - now.y_c_before[i]);
            let of = |y_u: &[f32; 2]| f64::from(heads.log_gain([at(0), at(1)], *y_u)).exp();
            now.y_u.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let fair = 1.0 / airborne.max(1) as f64;
        let outage_in = (0..AHEAD).find(|j| self.radio.share(gain(*j), TxPower::High) > fair);
        SlotRequest { vehicle: n, gain: gain(0), outage_in, waited, power }
    }

    /// One interval of those in the air: slots, radio, flight. Gives the commands as they were sent, with the power of
    /// their slot. `commands` and `requests` are in the order of `airborne`.
    pub fn fly(
        &mut self,
        airborne: &[usize],
        commands: &[Command],
        requests: &[SlotRequest],
        turn: u64,
    ) -> Vec<Command> {
        let slots = self.plan.scheduler.allot(requests, &self.radio, turn);
        let mut sent = Vec::new();
        for (n, command) in airborne.iter().zip(commands) {
            let member = &mut self.members[*n];
            let sim = member.craft.sim_mut();
            let slot = slots.iter().find(|slot| slot.vehicle == *n);
            let power = slot.map_or(command.power, |slot| slot.power);
            sim.set_power(power);
            let snr = sim.world().snr(power, &self.scenario);
            let carries = slot.is_some_and(|slot| {
                self.powers.push(power.level());
                !channel::outage(slot.share * self.radio.b_dt, snr, self.radio.packet_bits)
            });
            let command = Command { power, ..*command };
            if carries {
                sim.handle(command);
            }
            sim.receive(snr, !carries);
            sim.step();
            member.waited = if carries { 0 } else { member.waited + 1 };
            sent.push(command);
        }
        sent
    }

    /// Counts who collided, and names those that now touch and did not before.
    pub fn touch(&mut self, airborne: &[usize]) -> Vec<usize> {
        let reach = 2.0 * self.scenario.uav_radius + self.scenario.safety.d_min;
        let mut touching = Vec::new();
        for (k, a) in airborne.iter().enumerate() {
            for b in &airborne[k + 1..] {
                let apart = (self.members[*a].reported().r - self.members[*b].reported().r).norm();
                self.nearest = self.nearest.min(apart);
                if apart <= reach {
                    touching.push((*a, *b));
                }
            }
        }
        let entered: Vec<(usize, usize)> =
            touching.iter().filter(|pair| !self.touching.contains(pair)).copied().collect();
        self.collisions += entered.len() as u64;
        self.touching = touching;
        entered.iter().flat_map(|(a, b)| [*a, *b]).collect()
    }

    /// Whether vehicle `n` leaves the field after this turn, and why.
    pub fn land(&mut self, n: usize, turn: u64) -> Option<FleetLanding> {
        let (goal, radius, horizon) = (self.scenario.goal, self.scenario.goal_radius, self.scenario.horizon);
        let member = &mut self.members[n];
        let inside = (member.craft.sim().world().uav.r - goal).norm() <= radius;
        member.at_goal = if inside { member.at_goal + 1 } else { 0 };
        let landing = if member.craft.sim().is_fallen() {
            FleetLanding::Fell
        } else if member.at_goal >= LANDS {
            FleetLanding::AtGoal
        } else if turn + 1 >= member.leaves + horizon {
            FleetLanding::OutOfTime
        } else {
            return None;
        };
        member.landed = true;
        Some(landing)
    }
}
