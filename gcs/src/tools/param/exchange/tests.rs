//! Parameters over paths that lose, and vehicles that refuse.

use std::collections::VecDeque;

use crpl_sitl::link::decoder::Decoder;
use crpl_sitl::link::messages::param::ParamRequestRead;
use crpl_sitl::world::noise::{Noise, Stream};
use proptest::prelude::*;
use rand::RngExt;

use super::*;

const VEHICLE: (u8, u8) = (7, 1);

fn param(k: u16) -> Param {
    let kind = if k.is_multiple_of(3) { Kind::Real } else { Kind::Int { bits: 32, signed: true } };
    let value =
        if kind == Kind::Real { Number::Real(f32::from(k) / 8.0) } else { Number::Int(-i64::from(k)) };
    Param { name: format!("PARAM_{k}"), kind, value }
}

/// A vehicle with `count` parameters that hears and speaks through a path that loses `lost`.
struct Peer {
    params: Vec<Param>,
    encoding: Encoding,
    encoder: Encoder,
    keeps: bool,
}

impl Peer {
    fn new(count: u16, encoding: Encoding) -> Self {
        let params = (0..count).map(param).collect();
        Self { params, encoding, encoder: Encoder::new(VEHICLE.0, VEHICLE.1), keeps: false }
    }

    fn value(&mut self, index: usize) -> Vec<u8> {
        let param = &self.params[index];
        let told = ParamValue {
            value: param.value.encode(self.encoding).unwrap(),
            count: self.params.len() as u16,
            index: index as u16,
            name: param.name.as_str().into(),
            kind: param.kind.code(),
        };
        let mut out = Vec::new();
        self.encoder.push_view(&mut out, &told);
        out
    }

    fn hear(&mut self, packet: &Packet) -> Vec<Vec<u8>> {
        if packet.is::<PARAM_REQUEST_LIST_DATA>() {
            return (0..self.params.len()).map(|index| self.value(index)).collect();
        }
        let set = ParamSet::of(packet);
        let (at, name) = match (ParamRequestRead::of(packet), &set) {
            (Some(read), _) => (read.index, read.name),
            (None, Some(set)) => (-1, set.name),
            (None, None) => panic!("message {}", packet.id),
        };
        let index = match usize::try_from(at) {
            Ok(index) => index,
            Err(_) => match self.params.iter().position(|param| param.name == name.lossy()) {
                Some(index) => index,
                None => return vec![],
            },
        };
        if let Some(set) = set.filter(|_| !self.keeps) {
            let kind = self.params[index].kind;
            assert_eq!(set.kind, kind.code());
            self.params[index].value = Number::decode(set.value, kind, self.encoding);
        }
        vec![self.value(index)]
    }
}

/// Runs an exchange against a peer; the k-th packet of both ways together is lost if `lost(k)`.
fn run<E: Exchange>(
    exchange: &mut E,
    peer: &mut Peer,
    mut lost: impl FnMut(usize) -> bool,
) -> Result<E::Output, String> {
    let (mut ours, mut theirs) = (Decoder::default(), Decoder::default());
    let (mut station, mut count, mut now) = (Encoder::new(255, 190), 0, Duration::ZERO);
    for _ in 0..10_000 {
        let mut datagram = Vec::new();
        exchange.poll(now, &mut station, &mut datagram);
        if let Some(outcome) = exchange.outcome() {
            return outcome;
        }
        for packet in theirs.datagram(&datagram) {
            count += 1;
            if lost(count) {
                continue;
            }
            for answer in peer.hear(&packet) {
                count += 1;
                if !lost(count) {
                    for packet in ours.datagram(&answer) {
                        exchange.packet(&packet, now);
                    }
                }
            }
        }
        now = exchange.due().unwrap().max(now + Duration::from_millis(1));
    }
    panic!("the exchange hangs");
}

proptest! {
    #[test]
    fn a_list_is_whole_over_a_path_that_loses(
        count in 1u16..60, seed in any::<u64>(), percent in 0u64..40, bytewise in any::<bool>()
    ) {
        let encoding = if bytewise { Encoding::Bytewise } else { Encoding::CCast };
        let mut random = seed;
        let lost = |_| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) % 100 < percent
        };
        let mut peer = Peer::new(count, encoding);
        // Fortune may lose the same packet time and again; what came must be right all the same.
        match run(&mut List::new(VEHICLE, encoding), &mut peer, lost) {
            Ok(params) => prop_assert_eq!(params, peer.params),
            Err(why) => prop_assert!(percent >= 10, "{}", why),
        }
    }
}

#[test]
fn a_list_is_whole_where_every_fifth_packet_is_lost_at_random() {
    for seed in 0..1000 {
        let mut random = Noise::new(seed).generator(Stream::Start, 0);
        let mut peer = Peer::new(44, Encoding::CCast);
        let list = run(&mut List::new(VEHICLE, Encoding::CCast), &mut peer, |_| random.random_bool(0.2));
        assert_eq!(list, Ok(peer.params), "seed {seed}");
    }
}

/// Report G11: on a link of 2 parameters a second 387 requests were sent for 30 parameters.
#[test]
fn a_slow_link_is_asked_no_more_often_than_it_answers() {
    for (gap_ms, lost) in [(500_u64, false), (500, true), (2000, true), (20, true)] {
        let mut peer = Peer::new(30, Encoding::CCast);
        let mut list = List::new(VEHICLE, Encoding::CCast);
        let (mut station, mut ours) = (Encoder::new(255, 190), Decoder::default());
        let (mut theirs, mut queue, mut free) = (Decoder::default(), VecDeque::new(), 0_u64);
        let mut dropped = 0;
        for ms in 0..600_000_u64 {
            let now = Duration::from_millis(ms);
            if list.due().is_some_and(|due| due <= now) {
                let mut datagram = Vec::new();
                list.poll(now, &mut station, &mut datagram);
                for packet in theirs.datagram(&datagram) {
                    queue.extend(peer.hear(&packet));
                }
            }
            if ms >= free
                && let Some(answer) = queue.pop_front()
            {
                free = ms + gap_ms;
                dropped += 1;
                if !lost || dropped % 7 != 0 {
                    ours.datagram(&answer).iter().for_each(|packet| list.packet(packet, now));
                }
            }
            if let Some(outcome) = list.outcome() {
                assert_eq!(outcome.unwrap().len(), 30);
                break;
            }
        }
        assert!(list.found.len() == 30, "{gap_ms} ms: {} came", list.found.len());
        let asked = list.asked_again();
        assert!(asked <= if lost { 12 } else { 0 }, "{gap_ms} ms, lost {lost}: {asked} asked again");
    }
}

#[test]
fn a_list_asks_again_for_what_is_missing_alone() {
    let mut peer = Peer::new(50, Encoding::CCast);
    let mut list = List::new(VEHICLE, Encoding::CCast);
    let params = run(&mut list, &mut peer, |k| matches!(k, 10 | 20 | 51)).unwrap();
    assert_eq!((params, list.asked_again()), (peer.params, 3));
}

#[test]
fn a_value_is_set_echoed_and_a_refusal_told() {
    for encoding in [Encoding::CCast, Encoding::Bytewise] {
        let mut peer = Peer::new(5, encoding);
        let before = run(&mut Read::new("PARAM_4".into(), VEHICLE, encoding).unwrap(), &mut peer, |k| k == 2);
        assert_eq!(before, Ok(param(4)));
        let mut set = Set::new(&param(4), Number::Int(77), VEHICLE, encoding).unwrap();
        let taken = run(&mut set, &mut peer, |k| k < 3).unwrap();
        assert_eq!(taken, Written::Taken(Param { value: Number::Int(77), ..param(4) }));
        peer.keeps = true;
        let mut set = Set::new(&param(3), Number::Real(0.5), VEHICLE, encoding).unwrap();
        assert_eq!(run(&mut set, &mut peer, |_| false), Ok(Written::Kept(param(3))));
    }
}

#[test]
fn what_is_not_there_is_said_in_words() {
    let mut peer = Peer::new(5, Encoding::CCast);
    let mut read = Read::new("NO_SUCH".into(), VEHICLE, Encoding::CCast).unwrap();
    let why = run(&mut read, &mut peer, |_| false).unwrap_err();
    assert_eq!(why, "no answer for NO_SUCH: is there such a parameter?");
    let why = run(&mut List::new((9, 1), Encoding::CCast), &mut peer, |_| false).unwrap_err();
    assert_eq!(why, "no answer to a request for the parameters");
    let why = run(&mut List::new(VEHICLE, Encoding::CCast), &mut peer, |k| k > 4).unwrap_err();
    assert_eq!(why, "only 3 of 5 parameters came");
    assert!(Read::new("SEVENTEEN_LETTERS".into(), VEHICLE, Encoding::CCast).is_err());
}
