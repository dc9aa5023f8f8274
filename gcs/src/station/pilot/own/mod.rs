//! Controllers of somebody's own: a program that answers each percept with a command, by lines of JSON.
//!
//! | module | what it is |
//! |---|---|
//! | [`name`] | `exec:COMMAND` and its kin |
//! | [`protocol`] | the lines, and what may be in them |
//! | [`process`] | the program behind its pipes |
//!
//! An interval without a good answer is flown with the last command, and counted. Several of them on end, or the
//! program's end, end the flight. A process flies one flight after the other, as many processes as flights are
//! under way at a time; one that has failed flies no second flight.

pub mod name;
pub mod process;
pub mod protocol;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::units::{Motion, Scale, TxPower};
use serde::Serialize;

use crate::station::seen::MotionLimits;
use name::{OwnController, OwnKind};
use process::{Process, Silence};
use protocol::{Answer, Hello, HelloAnswer, OwnSight, PerceptLine, PictureFormat, Reset, VERSION};

/// Intervals on end without a good answer that end a flight.
pub const GIVES_UP: u32 = 5;
/// How long a program may take to start: some load a network first.
pub const START: Duration = Duration::from_secs(60);
/// The longest piece of a line that an error shows, characters.
const SHOWN: usize = 80;

/// Flags of controllers of somebody's own.
#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct OwnFlags {
    /// How long an exec: controller may take for an answer; after that its last command is flown on
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = crpl_sitl::program::terminal::positive)]
    pub exec_timeout: f64,
}

impl Default for OwnFlags {
    fn default() -> Self {
        Self { exec_timeout: 5.0 }
    }
}

impl OwnFlags {
    /// How long an answer is waited for.
    #[must_use]
    pub fn patience(self) -> Duration {
        Duration::try_from_secs_f64(self.exec_timeout).unwrap_or(Duration::MAX).min(START * 60)
    }
}

/// How a program has answered.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct AnswerTally {
    /// Intervals for which it was asked.
    pub asked: u64,
    /// Of these: no answer in time.
    pub timed_out: u64,
    /// A line that is no answer.
    pub junk: u64,
    /// The program had ended.
    pub crashed: u64,
    /// The first failure, in one line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<String>,
}

impl AnswerTally {
    /// Intervals that were flown with an older command.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.timed_out + self.junk + self.crashed
    }

    /// The failures in one line; `None` if there are none.
    #[must_use]
    pub fn told(&self) -> Option<String> {
        let first = self.first.as_deref()?;
        Some(format!(
            "{} of {} intervals without an answer ({} timed out, {} junk, {} crashed); first: {first}",
            self.missed(),
            self.asked,
            self.timed_out,
            self.junk,
            self.crashed
        ))
    }

    fn add(&mut self, other: &Self) {
        self.asked += other.asked;
        self.timed_out += other.timed_out;
        self.junk += other.junk;
        self.crashed += other.crashed;
        if self.first.is_none() {
            self.first.clone_from(&other.first);
        }
    }
}

/// What all flights of one program share.
#[derive(Debug)]
struct Program {
    controller: OwnController,
    patience: Duration,
    hello: String,
    world: Arc<WorldModel>,
    scale: Scale,
    limits: MotionLimits,
    idle: Mutex<Vec<Greeted>>,
    tally: Mutex<AnswerTally>,
}

/// A process that has answered to hello.
#[derive(Debug)]
struct Greeted {
    process: Process,
    picture: PictureFormat,
    flights: u64,
}

/// A program that flies. A clone begins a flight of its own.
#[derive(Debug)]
pub struct Own {
    program: Arc<Program>,
    flight: OwnFlight,
}

/// The flight under way.
#[derive(Debug, Default)]
struct OwnFlight {
    /// Behind a lock because flights are shared between threads; only its own uses it.
    process: Mutex<Option<Greeted>>,
    last: (Option<Motion>, TxPower),
    in_a_row: u32,
    tally: AnswerTally,
    failure: Option<String>,
}

impl Clone for Own {
    fn clone(&self) -> Self {
        Self { program: self.program.clone(), flight: OwnFlight::default() }
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        let flight = std::mem::take(&mut self.flight);
        locked(&self.program.tally).add(&flight.tally);
        if flight.tally.missed() == 0
            && let Some(process) = flight.process.into_inner().unwrap_or_else(PoisonError::into_inner)
        {
            locked(&self.program.idle).push(process);
        }
    }
}

/// What a lock holds, also after a thread has panicked: each value in it is whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Program {
    /// Starts a process and greets it.
    fn start(&self) -> Result<Greeted> {
        let name = self.controller.name();
        let mut process = Process::start(&self.controller.words()).with_context(|| name.to_owned())?;
        process.send(self.hello.clone());
        let line = process.receive(START.max(self.patience), |line| Some(line.to_owned()));
        let line = line.map_err(|silence| anyhow::anyhow!("{name}: no answer to hello: {silence}"))?;
        let answer: HelloAnswer = serde_json::from_str(&line)
            .with_context(|| format!("{name}: the answer to hello is `{}`", short(&line)))?;
        if answer.version != VERSION {
            bail!("{name}: the program speaks version {}, this one version {VERSION}", answer.version);
        }
        Ok(Greeted { process, picture: answer.picture, flights: 0 })
    }
}

impl Own {
    /// A program that flies `scenario`. It is started once to see that it does.
    ///
    /// # Errors
    /// There is no such program, or it does not answer to hello.
    pub fn new(
        controller: OwnController,
        flags: OwnFlags,
        world: &Arc<WorldModel>,
        scenario: &Scenario,
    ) -> Result<Self> {
        let hello = Hello::of(scenario, world, controller.kind == OwnKind::ExecTruth);
        let program = Program {
            controller,
            patience: flags.patience(),
            hello: serde_json::to_string(&hello)?,
            world: world.clone(),
            scale: scenario.scale,
            limits: MotionLimits::of(scenario),
            idle: Mutex::default(),
            tally: Mutex::default(),
        };
        let first = program.start()?;
        locked(&program.idle).push(first);
        Ok(Self { program: Arc::new(program), flight: OwnFlight::default() })
    }

    /// Whether it may see the true state.
    #[must_use]
    pub fn sees_truth(&self) -> bool {
        self.program.controller.kind == OwnKind::ExecTruth
    }

    /// Motion and power for the interval that begins; those of the interval before where the program gives none.
    pub fn decide(&mut self, seen: &OwnSight<'_>) -> (Motion, TxPower) {
        if self.flight.failure.is_none() {
            self.flight.tally.asked += 1;
            match self.ask(seen) {
                Ok((motion, power)) => {
                    self.flight.last = (Some(motion), power);
                    self.flight.in_a_row = 0;
                }
                Err(why) => self.missed(seen.heard.tick.0, &why),
            }
        }
        let (motion, power) = self.flight.last;
        (motion.unwrap_or(Motion::Coast), power)
    }

    fn ask(&mut self, seen: &OwnSight<'_>) -> Result<(Motion, TxPower), NoAnswer> {
        let Program { patience, world, scale, limits, .. } = &*self.program;
        let process = self.flight.process.get_mut().unwrap_or_else(PoisonError::into_inner);
        let greeted = match process.as_mut() {
            Some(greeted) => greeted,
            None => {
                let idle = locked(&self.program.idle).pop();
                let mut greeted = match idle {
                    Some(greeted) => greeted,
                    None => self.program.start().map_err(|error| NoAnswer::Crashed(format!("{error:#}")))?,
                };
                greeted.flights += 1;
                greeted.process.send(json(&Reset { flight: greeted.flights }));
                process.insert(greeted)
            }
        };
        let action = |held: crpl_sitl::radio::message::Held| {
            scale.paper_from_ned_acceleration(held.accel) / limits.a_max
        };
        greeted.process.send(json(&PerceptLine::of(seen, world, greeted.picture, action)));
        let tick = seen.heard.tick.0;
        let answer = greeted.process.receive(*patience, |line| match Answer::parse(line) {
            // The answer to an interval that is over.
            Ok(answer) if answer.tick < tick => None,
            Ok(answer) if answer.tick > tick => {
                Some(Err(NoAnswer::Junk(format!("`{}` answers a tick to come", short(line)))))
            }
            Ok(answer) => Some(Ok(answer.decision())),
            Err(error) => Some(Err(NoAnswer::Junk(format!("`{}`: {error}", short(line))))),
        });
        answer.unwrap_or_else(|silence| match silence {
            Silence::TimedOut(_) => Err(NoAnswer::TimedOut(silence.to_string())),
            Silence::Ended(_) => Err(NoAnswer::Crashed(silence.to_string())),
        })
    }

    /// An interval without an answer: counted, told, and at some point the end.
    fn missed(&mut self, tick: u64, no_answer: &NoAnswer) {
        let flight = &mut self.flight;
        let (count, why) = match no_answer {
            NoAnswer::TimedOut(why) => (&mut flight.tally.timed_out, why),
            NoAnswer::Junk(why) => (&mut flight.tally.junk, why),
            NoAnswer::Crashed(why) => (&mut flight.tally.crashed, why),
        };
        *count += 1;
        flight.in_a_row += 1;
        let line = format!("interval {tick}: {why}");
        let name = self.program.controller.name();
        if flight.tally.first.is_none() {
            tracing::warn!("{name}: {line}; its last command is flown on");
            flight.tally.first = Some(line.clone());
        }
        if matches!(no_answer, NoAnswer::Crashed(_)) {
            flight.failure = Some(format!("{name}: {line}"));
        } else if flight.in_a_row >= GIVES_UP {
            flight.failure = Some(format!("{name}: no answer in {GIVES_UP} intervals on end; {line}"));
        }
    }

    /// Why the flight cannot go on, if it cannot.
    #[must_use]
    pub fn failure(&self) -> Option<&str> {
        self.flight.failure.as_deref()
    }

    /// How the program has answered in this flight.
    #[must_use]
    pub fn answers(&self) -> &AnswerTally {
        &self.flight.tally
    }

    /// How it has answered in all flights that are over.
    #[must_use]
    pub fn all_answers(&self) -> AnswerTally {
        locked(&self.program.tally).clone()
    }
}

/// Why an interval has no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
enum NoAnswer {
    TimedOut(String),
    Junk(String),
    Crashed(String),
}

/// A line of the protocol; its values all have a JSON form.
fn json(line: &impl Serialize) -> String {
    serde_json::to_string(line).unwrap_or_default()
}

/// The beginning of a line, for an error.
fn short(line: &str) -> String {
    match line.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &line[..end]),
        None => line.into(),
    }
}
