//! `gcs encode`: the companion's half of CRPL. Pictures stop here, and their latents go on to the ground.
//!
//! ```text
//! vehicle <--> gcs encode <--> radio <--> gcs fly
//!     picture, up to 11 kB    latents, some 80 bytes
//! ```
//!
//! Everything else passes byte for byte, both ways. Pictures are asked for here, so requests of the ground go no
//! further. [`PictureEncoder`] knows no socket and no clock.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use crpl_model::world_model::WorldModel;
use crpl_sitl::Scenario;
use crpl_sitl::link::encoder::Encoder;
use crpl_sitl::link::endpoint::Endpoint;
use crpl_sitl::link::image::{self, Reassembler};
use crpl_sitl::link::latents::{self, LatentsError, MAX_VECTORS};
use crpl_sitl::link::links::{Arrival, BUFFER, Links};
use crpl_sitl::link::packet::Packet;
use crpl_sitl::link::splitter::Splitter;
use crpl_sitl::link::wire::Clock;
use crpl_sitl::link::{COMPANION, PeerId};
use crpl_sitl::program::air::is_picture;
use crpl_sitl::program::camera::CameraFlag;
use crpl_sitl::program::terminal::{interrupted, say};
use crpl_sitl::scenario::presets;
use tokio::time::interval;

use crate::station::models::Models;
use crate::station::sighting::Sighting;
use crate::tools::link::LINKS;

/// How often pictures are asked for.
const ASKS: Duration = Duration::from_secs(1);
/// The vehicle's endpoint is the first.
const VEHICLE: usize = 0;

/// Flags of `gcs encode`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = presets::table())]
pub struct EncodeFlags {
    /// Endpoint of the vehicle: udpout:HOST:PORT, or udpin, tcpout, tcpin
    #[arg(long, value_name = "ENDPOINT")]
    vehicle: Endpoint,
    /// Endpoints of the ground; repeatable
    #[arg(long, value_name = "ENDPOINT", num_args = 1.., required = true)]
    ground: Vec<Endpoint>,
    /// The vehicle's scenario: TOML file or preset
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    scenario: String,
    #[command(flatten)]
    camera: CameraFlag,
    /// World model: a folder, or `learned` or `centroid`, which are built in; the ground must have the same
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    /// Width of a latent's number, bits
    #[arg(long, value_name = "BITS", default_value_t = 10, value_parser = clap::value_parser!(u8).range(4..=16))]
    bits: u8,
}

/// Bytes of a vehicle in, bytes for the ground out.
#[derive(Debug)]
pub struct PictureEncoder<'a> {
    world: &'a WorldModel,
    obstacles: usize,
    bits: u8,
    clock: Clock,
    splitter: Splitter,
    images: Reassembler,
    /// Writes as the vehicle's companion, once the vehicle is known.
    encoder: Option<Encoder>,
    encoded: u64,
}

impl<'a> PictureEncoder<'a> {
    /// For the pictures of a scenario, latents in numbers of `bits` bits.
    ///
    /// # Errors
    /// Latents of so many obstacles do not fit into a message.
    pub fn new(world: &'a WorldModel, scenario: &Scenario, bits: u8) -> Result<Self, LatentsError> {
        let obstacles = scenario.obstacles.len();
        if obstacles >= MAX_VECTORS {
            return Err(LatentsError::Vectors(obstacles + 1));
        }
        Ok(Self {
            world,
            obstacles,
            bits,
            clock: Clock::new(scenario),
            splitter: Splitter::default(),
            images: Reassembler::default(),
            encoder: None,
            encoded: 0,
        })
    }

    /// Bytes of the vehicle: what is to go to the ground in their place.
    pub fn encode(&mut self, bytes: &[u8]) -> Vec<u8> {
        let Self { world, obstacles, bits, clock, splitter, images, encoder, encoded } = self;
        let mut out = Vec::with_capacity(bytes.len());
        splitter.split(bytes, |frame| {
            if !is_picture(frame.id) {
                out.extend_from_slice(frame.raw);
                return;
            }
            let Some((tick, picture)) = images.push(&Packet::from(frame)) else { return };
            let encoder = encoder.get_or_insert_with(|| Encoder::new(frame.system, COMPANION));
            let sent = Sighting::of(world, &picture, *obstacles).to_latents(world, tick);
            match latents::push(&sent, *bits, clock, encoder, &mut out) {
                Ok(()) => *encoded += 1,
                Err(error) => tracing::debug!("tick {}: {error}", tick.0),
            }
        });
        out
    }

    /// Pictures that were encoded.
    #[must_use]
    pub fn encoded(&self) -> u64 {
        self.encoded
    }
}

/// Encodes until Ctrl-C.
///
/// # Errors
/// A scenario or model that does not read, an endpoint that cannot be opened.
pub async fn run(args: EncodeFlags) -> Result<()> {
    let scenario = args.camera.scenario(&args.scenario)?;
    let models = Models::load(args.checkpoint.as_deref(), None)?;
    let mut pictures = PictureEncoder::new(&models.world, &scenario, args.bits)?;
    let mut links = Links::new(LINKS);
    for (role, endpoint) in
        std::iter::once(("vehicle", &args.vehicle)).chain(args.ground.iter().map(|end| ("ground", end)))
    {
        let index = links.add(endpoint).await?;
        say(&format!("{role}: {}", links.describe().swap_remove(index)));
    }
    let mut peers: BTreeMap<PeerId, Splitter> =
        links.fixed().into_iter().map(|peer| (peer, Splitter::default())).collect();
    let mut asks = interval(ASKS);
    let (mut ask, mut encoder) = (Vec::new(), Encoder::new(1, COMPANION));
    let mut buffer = vec![0; BUFFER];
    let mut interrupted = std::pin::pin!(interrupted());
    loop {
        let (to_ground, bytes) = tokio::select! {
            arrival = links.receive(&mut buffer) => match arrival {
                Arrival::Bytes(from, length) => {
                    let from = links.fixed_at(from.endpoint).unwrap_or(from);
                    let splitter = peers.entry(from).or_default();
                    match from.endpoint == VEHICLE {
                        true => (true, pictures.encode(&buffer[..length])),
                        false => (false, without_requests(splitter, &buffer[..length])),
                    }
                }
                Arrival::Connected(peer) => {
                    peers.insert(peer, Splitter::default());
                    continue;
                }
                Arrival::Closed(peer) => {
                    peers.remove(&peer);
                    continue;
                }
            },
            _ = asks.tick() => {
                ask.clear();
                image::push_request(&mut encoder, &mut ask);
                (false, ask.clone())
            }
            _ = &mut interrupted => break,
        };
        for peer in peers.keys().filter(|peer| (peer.endpoint != VEHICLE) == to_ground && !bytes.is_empty()) {
            if let Err(error) = links.send(*peer, &bytes) {
                tracing::debug!(%peer, "sending: {error}");
            }
        }
        links.flush().await;
    }
    links.close().await;
    say(&format!("{} pictures encoded", pictures.encoded()));
    Ok(())
}

/// What a ground station says, without its requests for pictures.
fn without_requests(splitter: &mut Splitter, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    splitter.split(bytes, |frame| {
        if !is_picture(frame.id) {
            out.extend_from_slice(frame.raw);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use crpl_sitl::Sim;
    use crpl_sitl::link::dialect::HEARTBEAT_DATA;
    use crpl_sitl::units::Tick;

    use super::*;

    #[test]
    fn pictures_become_latents_and_all_else_passes_byte_for_byte() {
        let (scenario, world) = (Scenario::default(), WorldModel::embedded().unwrap());
        let frame = Sim::new(scenario.clone(), 1).frame();
        let png = image::png_from_frame(&frame, Tick(4)).unwrap();
        let mut vehicle = Encoder::new(7, 1);
        let mut beat = Vec::new();
        vehicle.push(&mut beat, &HEARTBEAT_DATA::default());
        let mut bytes = beat.clone();
        for n in 0..image::datagram_count(&png) {
            bytes.extend(image::datagram(&png, n, &mut vehicle));
        }
        let mut pictures = PictureEncoder::new(&world, &scenario, 16).unwrap();
        // Cut anywhere.
        let mut out: Vec<u8> = bytes.chunks(100).flat_map(|part| pictures.encode(part)).collect();
        assert_eq!(out[..beat.len()], beat);
        let latents = out.split_off(beat.len());
        assert!(latents.len() < 130 && pictures.encoded() == 1, "{}", latents.len());
        let packet = crpl_sitl::link::decoder::Decoder::default().datagram(&latents).remove(0);
        assert_eq!((packet.system, packet.component), (7, COMPANION));
        let sent = latents::of(&packet, &Clock::new(&scenario)).unwrap();
        let (heard, here) = (Sighting::of_latents(&world, &sent).unwrap(), Sighting::of(&world, &frame, 1));
        assert_eq!(sent.tick, Tick(4));
        assert!((heard.c.y - here.c.y).norm() < 1e-3 && (heard.u[0].y - here.u[0].y).norm() < 1e-3);
        assert!(heard.c.sigma_scale >= here.c.sigma_scale);
    }

    #[test]
    fn the_ground_s_requests_for_pictures_go_no_further() {
        let (mut bytes, mut encoder) = (Vec::new(), Encoder::new(255, 190));
        image::push_request(&mut encoder, &mut bytes);
        let asked = bytes.len();
        encoder.push(&mut bytes, &HEARTBEAT_DATA::default());
        assert_eq!(without_requests(&mut Splitter::default(), &bytes), bytes[asked..]);
    }
}
