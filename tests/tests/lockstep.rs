//! A flight in lockstep is the same flight wherever it takes place: in process, over UDP, and over a
//! path that loses datagrams. Every record is equal, byte for byte.
//!
//! The station here is a few lines that depend on every byte of a percept; what CRPL makes of it is
//! another test's matter.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use crpl_gcs::flight::{Crew, FlightEnd, Options, fly};
use crpl_sitl::radio::message::{Command, Percept};
use crpl_sitl::sim::record::Record;
use crpl_sitl::units::TxPower;
use crpl_sitl::{Scenario, Sim};
use tests::program::{self, Program};
use tests::python;
use tests::relay::Relay;

const TICKS: u64 = 100;
const SEED: u64 = 7;

/// Gusts, and a bandwidth at which packets fail.
const CONFIG: &str = "[radio]\nb_dt = 2.5\n\n[disturbance]\nsigma_c = 0.005\n";

/// Through this camera.
fn scenario(camera: &str) -> Scenario {
    let mut scenario = Scenario::from_toml(CONFIG).expect("the config of this test");
    scenario.film_with(camera).expect("a camera with a name");
    scenario
}

/// Steers to the goal by what it was told; the picture's bytes decide the power.
fn decide(percept: &Percept, scenario: &Scenario) -> Command {
    let told = &percept.telemetry;
    let goal = scenario.scale.ned_from_paper(scenario.goal);
    let axis = |i: usize| {
        let wish = 0.05 * (goal[i] - told.position[i]) - 0.5 * told.velocity[i];
        wish.clamp(-10.0, 10.0)
    };
    let sum: u32 = percept.frame.rgb().iter().map(|&byte| u32::from(byte)).sum();
    let power = if sum.is_multiple_of(2) { TxPower::Low } else { TxPower::High };
    Command::new(told.tick, [axis(0), axis(1)], power)
}

/// One line per interval, from the percepts and the commands between them.
fn lines(percepts: &[Percept], commands: &[Command], scenario: &Scenario) -> Vec<String> {
    assert_eq!(percepts.len(), commands.len() + 1);
    let record = |(pair, command): (&[Percept], &Command)| {
        let record = Record::new(&pair[0].telemetry, command, &pair[1].telemetry, scenario);
        serde_json::to_string(&record).expect("a record is JSON")
    };
    percepts.windows(2).zip(commands).map(record).collect()
}

fn in_process(camera: &str) -> Vec<String> {
    let scenario = scenario(camera);
    let mut sim = Sim::new(scenario.clone(), SEED);
    let (mut percepts, mut commands) = (vec![sim.percept()], Vec::new());
    for _ in 0..TICKS {
        let command = decide(&percepts[percepts.len() - 1], &scenario);
        commands.push(command);
        sim.handle(command);
        sim.advance();
        percepts.push(sim.percept());
    }
    lines(&percepts, &commands, &scenario)
}

/// Starts the real `sitl` in lockstep.
fn vehicle(folder: &Path, camera: &str) -> (Program, SocketAddr) {
    let config = folder.join("scenario.toml");
    std::fs::write(&config, CONFIG).expect("writing the config");
    let config = config.to_str().expect("a plain path");
    let flags = ["--pace", "lockstep", "--scenario", config, "--seed", "7", "--ticks", "100"];
    program::sitl(&[&flags[..], &["--camera", camera]].concat()).expect("starting sitl")
}

/// Decides, and remembers all that it saw and said.
struct Witness {
    scenario: Scenario,
    percepts: Vec<Percept>,
    commands: Vec<Command>,
    tlog: Option<PathBuf>,
}

impl Crew for Witness {
    fn command(&mut self, percept: &Percept) -> Command {
        let command = decide(percept, &self.scenario);
        self.percepts.push(percept.clone());
        self.commands.push(command);
        command
    }

    fn begin(&mut self) -> anyhow::Result<Option<PathBuf>> {
        Ok(self.tlog.clone())
    }
}

/// Flies against whatever listens at `address`.
async fn over_udp(address: SocketAddr, camera: &str, tlog: Option<PathBuf>) -> Vec<String> {
    let scenario = scenario(camera);
    let connect = format!("udpout:{address}").parse().expect("an endpoint");
    let options = Options { ticks: Some(TICKS), ..Options::default() };
    let mut crew = Witness { scenario: scenario.clone(), percepts: Vec::new(), commands: Vec::new(), tlog };
    let flight = fly(&connect, &scenario, &options, &mut crew).await.expect("a flight to its end");
    assert_eq!(flight.ended, FlightEnd::Over);
    crew.percepts.extend(flight.last);
    lines(&crew.percepts, &crew.commands, &scenario)
}

fn assert_over(sitl: Program) {
    let said = sitl.wait().expect("sitl ends by itself").good().expect("sitl ends well");
    assert!(said.contains("flight over after 100 ticks"), "{said}");
    assert!(said.contains("commands: 100 sent"), "{said}");
}

#[test]
fn the_flight_has_outages_and_both_powers() {
    let flight = in_process("clean").join("\n");
    for needed in [r#""outage":true"#, r#""outage":false"#, r#""power":1"#, r#""power":4"#] {
        assert!(flight.contains(needed), "no {needed}: this flight proves little");
    }
}

/// And its tlog is one that pymavlink reads without a complaint.
#[tokio::test]
async fn over_udp_it_is_the_flight_in_process() {
    let folder = tempfile::tempdir().unwrap();
    let (sitl, address) = vehicle(folder.path(), "clean");
    let tlog = folder.path().join("flight.tlog");
    assert_eq!(over_udp(address, "clean", Some(tlog.clone())).await, in_process("clean"));
    assert_over(sitl);

    let read = python::script("read_tlog.py", &[&tlog]).unwrap().good().unwrap();
    let read: serde_json::Value = serde_json::from_str(&read).unwrap();
    assert_eq!(read["gaps"], 0, "{read}");
    for (kind, least) in [
        ("1/1 LOCAL_POSITION_NED", TICKS + 1),
        ("1/1 ENCAPSULATED_DATA", TICKS + 1),
        ("1/68 NAMED_VALUE_FLOAT", 3 * TICKS),
        ("255/190 SET_POSITION_TARGET_LOCAL_NED", TICKS),
        ("255/190 COMMAND_LONG", TICKS),
    ] {
        assert!(read["kinds"][kind].as_u64().is_some_and(|n| n >= least), "{kind}: {read}");
    }
    let dump = python::mavlogdump(&tlog).unwrap();
    assert!(dump.contains("SET_POSITION_TARGET_LOCAL_NED") && !dump.contains("BAD_DATA"), "{dump}");
    let loss = python::mavloss(&tlog).unwrap();
    assert!(loss.contains(" packets, 0 lost 0.0%"), "{loss}");
}

#[tokio::test]
async fn lost_datagrams_delay_it_and_change_nothing() {
    for every in [7, 3] {
        let folder = tempfile::tempdir().unwrap();
        let (sitl, address) = vehicle(folder.path(), "clean");
        let relay = Relay::to(address, every).unwrap();
        assert_eq!(
            over_udp(relay.address(), "clean", None).await,
            in_process("clean"),
            "every {every}th lost"
        );
        let (seen, lost) = relay.counts();
        assert!(lost > 10, "{lost} of {seen} datagrams lost");
        assert_over(sitl);
    }
}

#[tokio::test]
async fn a_hard_camera_s_pictures_are_the_same_over_udp() {
    let folder = tempfile::tempdir().unwrap();
    let (sitl, address) = vehicle(folder.path(), "harder");
    let flight = over_udp(address, "harder", None).await;
    assert_eq!(flight, in_process("harder"));
    assert_ne!(flight, in_process("clean"), "the pictures' bytes decide the power");
    assert_over(sitl);
}
