//! The camera as component 100, by the camera protocol v2: what it is, and pictures on command. Knows when a
//! picture is taken, not what is in it: it is that of the image protocol, north down and east to the right.
//!
//! | asked, of the camera or the autopilot | answered |
//! |---|---|
//! | REQUEST_MESSAGE, or 521, 522, 525, 527: CAMERA_INFORMATION (259), CAMERA_SETTINGS (260), STORAGE_INFORMATION (261), CAMERA_CAPTURE_STATUS (262) | ACCEPTED, then the message |
//! | IMAGE_START_CAPTURE (2000): param2 seconds between pictures, param3 how many, 0 for ever | ACCEPTED; CAMERA_IMAGE_CAPTURED (263) to all and the picture, by the image transmission protocol, to the asker; DENIED if a number is none |
//! | IMAGE_STOP_CAPTURE (2001) | ACCEPTED |
//! | REQUEST_CAMERA_IMAGE_CAPTURE (2002): param1 an index, -1 the newest | ACCEPTED, then CAMERA_IMAGE_CAPTURED; no such picture: DENIED |
//! | SET_CAMERA_MODE (530) | ACCEPTED for images, DENIED for video |
//! | VIDEO_START_CAPTURE (2500) | ACCEPTED; the picture of every interval, by the image transmission protocol, to the asker; CAMERA_CAPTURE_STATUS tells it when it is asked for |
//! | VIDEO_STOP_CAPTURE (2501) | ACCEPTED; the asker's pictures end |
//! | other camera commands | UNSUPPORTED |

use std::collections::VecDeque;
use std::time::Duration;

use super::Vehicle;
use super::messages::{self, VehicleState};
use crate::link::dialect::{self, MavBool, MavResult};
use crate::link::image::ImageRequest;
use crate::link::wire::{Ask, Clock};
use crate::link::{CAMERA, MessageData, PeerId};
use crate::units::Tick;

const CMD_REQUEST_INFORMATION: u16 = 521;
const CMD_REQUEST_SETTINGS: u16 = 522;
const CMD_REQUEST_STORAGE: u16 = 525;
const CMD_REQUEST_STATUS: u16 = 527;
const CMD_SET_MODE: u16 = 530;
const CMD_START_CAPTURE: u16 = 2000;
const CMD_STOP_CAPTURE: u16 = 2001;
const CMD_REQUEST_CAPTURE: u16 = 2002;
const CMD_START_VIDEO: u16 = 2500;
const CMD_STOP_VIDEO: u16 = 2501;
/// All commands of this module.
pub(super) const COMMANDS: [u16; 10] = [
    CMD_REQUEST_INFORMATION,
    CMD_REQUEST_SETTINGS,
    CMD_REQUEST_STORAGE,
    CMD_REQUEST_STATUS,
    CMD_SET_MODE,
    CMD_START_CAPTURE,
    CMD_STOP_CAPTURE,
    CMD_REQUEST_CAPTURE,
    CMD_START_VIDEO,
    CMD_STOP_VIDEO,
];
const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
/// Pictures that are remembered.
const MAX_SHOTS: usize = 1000;
/// The longest time between two pictures, s.
const LONGEST_S: f32 = 1e6;

/// The pictures that were taken on command, and those to come.
#[derive(Debug, Clone, Default)]
pub(super) struct Shots {
    taken: VecDeque<dialect::CAMERA_IMAGE_CAPTURED_DATA>,
    count: i32,
    series: Option<ShotSeries>,
    /// Since when there is a video.
    video: Option<Tick>,
}

#[derive(Debug, Clone, Copy)]
struct ShotSeries {
    to: PeerId,
    /// Intervals between two pictures.
    every: u64,
    next: Tick,
    /// How many are left; `None` for ever.
    left: Option<u32>,
    seconds: f32,
}

impl Shots {
    /// CAMERA_CAPTURE_STATUS.
    pub fn status(&self, clock: &Clock, now: Tick) -> dialect::CAMERA_CAPTURE_STATUS_DATA {
        let time_boot_ms = clock.boot_ms(now);
        dialect::CAMERA_CAPTURE_STATUS_DATA {
            time_boot_ms,
            video_status: u8::from(self.video.is_some()),
            recording_time_ms: self.video.map_or(0, |since| time_boot_ms.wrapping_sub(clock.boot_ms(since))),
            image_interval: self.series.map_or(0.0, |series| series.seconds),
            // 2: a series is under way, between two pictures.
            image_status: if self.series.is_some() { 2 } else { 0 },
            image_count: self.count,
            ..Default::default()
        }
    }
}

impl Vehicle {
    /// What becomes of a command of this module; `component` answers.
    pub(super) fn camera_command(
        &mut self,
        ask: &Ask,
        component: u8,
        asker: (u8, u8),
        from: PeerId,
        now: Duration,
    ) {
        let [first, second, third, _] = ask.params;
        let message = match ask.command {
            CMD_REQUEST_INFORMATION => Some(dialect::CAMERA_INFORMATION_DATA::ID),
            CMD_REQUEST_SETTINGS => Some(dialect::CAMERA_SETTINGS_DATA::ID),
            CMD_REQUEST_STORAGE => Some(dialect::STORAGE_INFORMATION_DATA::ID),
            CMD_REQUEST_STATUS => Some(dialect::CAMERA_CAPTURE_STATUS_DATA::ID),
            _ => None,
        };
        let shot = match ask.command {
            CMD_REQUEST_CAPTURE => self.shot(first).cloned(),
            _ => None,
        };
        let result = match ask.command {
            CMD_START_CAPTURE => self.start_capture(second, third, from),
            CMD_STOP_CAPTURE => {
                self.shots.series = None;
                ACCEPTED
            }
            CMD_REQUEST_CAPTURE if shot.is_none() => DENIED,
            CMD_SET_MODE if second != 0.0 => DENIED,
            CMD_START_VIDEO => {
                self.shots.video.get_or_insert(self.sim.tick());
                ACCEPTED
            }
            CMD_STOP_VIDEO => {
                self.shots.video = None;
                ACCEPTED
            }
            _ => ACCEPTED,
        };
        self.ack(ask.command, result, component, asker, from);
        if let Some(row) = message.and_then(|id| messages::row(id, CAMERA)) {
            self.send_message(row, from, now);
        }
        if let Some(shot) = shot {
            self.tell_shot(&shot, Some(from));
        }
        match ask.command {
            CMD_START_CAPTURE if result == ACCEPTED => self.take_shots(now),
            CMD_START_VIDEO => self.image_request(ImageRequest::Start, from, now),
            CMD_STOP_VIDEO => self.image_request(ImageRequest::Stop, from, now),
            _ => {}
        }
    }

    fn shot(&self, index: f32) -> Option<&dialect::CAMERA_IMAGE_CAPTURED_DATA> {
        let taken = &self.shots.taken;
        if index == -1.0 { taken.back() } else { taken.iter().find(|shot| shot.image_index as f32 == index) }
    }

    fn start_capture(&mut self, seconds: f32, total: f32, to: PeerId) -> MavResult {
        if !(0.0..=LONGEST_S).contains(&seconds) || !(0.0..=1e6).contains(&total) {
            return DENIED;
        }
        let every = (f64::from(seconds) / self.clock.interval_s()).round().max(1.0) as u64;
        let left = Some(total as u32).filter(|total| *total > 0);
        self.shots.series = Some(ShotSeries { to, every, next: self.sim.tick(), left, seconds });
        ACCEPTED
    }

    /// Takes the picture that is due in this interval, if one is.
    pub(super) fn take_shots(&mut self, now: Duration) {
        let tick = self.sim.tick();
        let Some(series) = self.shots.series.filter(|series| series.next <= tick) else { return };
        let left = series.left.map(|left| left - 1);
        let next = Tick(tick.0 + series.every);
        self.shots.series = Some(ShotSeries { left, next, ..series }).filter(|_| left != Some(0));
        let shot = captured(&self.state(now), self.shots.count);
        self.shots.count = self.shots.count.saturating_add(1);
        if self.shots.taken.len() == MAX_SHOTS {
            self.shots.taken.pop_front();
        }
        self.shots.taken.push_back(shot.clone());
        self.tell_shot(&shot, None);
        self.send_image(series.to);
    }

    /// Tells of a picture, to one peer or to all.
    fn tell_shot(&mut self, shot: &dialect::CAMERA_IMAGE_CAPTURED_DATA, to: Option<PeerId>) {
        for (&address, peer) in
            self.peers.iter_mut().filter(|(address, _)| to.is_none_or(|to| to == **address))
        {
            let mut datagram = Vec::new();
            peer.camera.push(&mut datagram, shot);
            self.outbox.push_back((address, datagram));
        }
    }
}

/// The picture of this moment. It lies nowhere: it goes by the image transmission protocol.
fn captured(state: &VehicleState, image_index: i32) -> dialect::CAMERA_IMAGE_CAPTURED_DATA {
    let [lat, lon] = state.site.latitude_longitude(state.report.position);
    let millimetres = |metres: f64| (metres * 1e3).round() as i32;
    dialect::CAMERA_IMAGE_CAPTURED_DATA {
        time_utc: state.unix.map_or(0, |unix| unix.as_micros() as u64),
        time_boot_ms: state.boot_ms(),
        lat,
        lon,
        alt: millimetres(state.site.altitude_m + state.height.altitude_m),
        relative_alt: millimetres(state.height.altitude_m),
        // It looks straight down with north at its lower edge, however the vehicle is tilted.
        q: [0.0, 1.0, 0.0, 0.0],
        image_index,
        camera_id: 0,
        capture_result: MavBool::MAV_BOOL_TRUE,
        file_url: "".into(),
    }
}
