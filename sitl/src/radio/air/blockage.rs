//! What stands between the two ends: discs, prisms, and buildings of a GeoJSON file.
//!
//! Places are north, east and height above the ground in metres, in the frame of the station's base. The obstacle
//! that obstructs most counts: a further one in the same sight line changes little (the rule of
//! [`crate::world::obstacles`]).

use std::path::Path;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::pathloss::LIGHT;
use crate::units::earth;
use crate::world::channel::{distance_to_sight_line, sigmoid};

/// An upright cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscObstacle {
    /// Its centre: north, east, m.
    pub centre: [f64; 2],
    /// m.
    pub radius_m: f64,
    /// Height above the ground, m; without one it is as high as the sky.
    pub height_m: Option<f64>,
}

/// An upright prism: a building.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prism {
    /// The corners of its ground plan in order: north, east, m.
    pub corners: Vec<[f64; 2]>,
    /// Height above the ground, m.
    pub height_m: f64,
}

/// What an obstacle in the sight line costs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "kebab-case", deny_unknown_fields)]
pub enum BlockageLoss {
    /// Diffraction at its nearest edge as at a knife edge, at most `limit_db`: ITU-R P.526-15, Sec. 4.1.
    KnifeEdge {
        /// What comes by other ways, dB.
        limit_db: f64,
    },
    /// The paper's smooth shadow (Sec. IV-A3): the power is that of the sight line times (1 - p) + κ p with
    /// p = sigmoid(obstruction / τ_b).
    Soft {
        /// κ in (0, 1].
        attenuation: f64,
        /// τ_b, m.
        softness_m: f64,
    },
}

impl BlockageLoss {
    /// The loss in dB, by how far the obstacle reaches over the sight line.
    #[must_use]
    pub fn db(&self, edge: &BlockingEdge, carrier: f64) -> f64 {
        match *self {
            Self::KnifeEdge { limit_db } => knife_edge(edge.fresnel(carrier)).min(limit_db),
            Self::Soft { attenuation, softness_m } => {
                let p = sigmoid(edge.reach / softness_m);
                -10.0 * ((1.0 - p) + attenuation * p).log10()
            }
        }
    }
}

/// J(ν) in dB, the loss at a knife edge; 0 below ν = -0.78. ITU-R P.526-15, Eq. (31).
#[must_use]
pub fn knife_edge(nu: f64) -> f64 {
    if nu <= -0.78 {
        return 0.0;
    }
    6.9 + 20.0 * (((nu - 0.1).powi(2) + 1.0).sqrt() + nu - 0.1).log10()
}

/// The edge over which a wave passes an obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockingEdge {
    /// How far the obstacle reaches over the sight line there, m; negative where the line passes it.
    pub reach: f64,
    /// Distances to the station and to the vehicle, m.
    pub ends: [f64; 2],
}

impl BlockingEdge {
    /// ν = h √(2 / λ (1 / d1 + 1 / d2)): ITU-R P.526-15, Eq. (26).
    #[must_use]
    pub fn fresnel(&self, carrier: f64) -> f64 {
        let [d1, d2] = self.ends.map(|d| d.max(1e-3));
        self.reach * (2.0 * carrier / LIGHT * (1.0 / d1 + 1.0 / d2)).sqrt()
    }
}

/// All that stands around.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surroundings {
    discs: Vec<DiscObstacle>,
    prisms: Vec<Prism>,
}

impl Surroundings {
    /// These discs and prisms.
    #[must_use]
    pub fn new(discs: Vec<DiscObstacle>, prisms: Vec<Prism>) -> Self {
        Self { discs, prisms }
    }

    /// The discs stand here from now on.
    pub fn set_discs(&mut self, discs: Vec<DiscObstacle>) {
        self.discs = discs;
    }

    /// Whether nothing stands around.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.discs.is_empty() && self.prisms.is_empty()
    }

    /// The edge of the obstacle that reaches farthest over the sight line from `base` to `vehicle`.
    #[must_use]
    pub fn worst(&self, base: Vector3<f64>, vehicle: Vector3<f64>) -> Option<BlockingEdge> {
        let sight = AirPath { base, vehicle };
        let discs = self.discs.iter().map(|disc| sight.past_disc(disc));
        let edges = discs.chain(self.prisms.iter().map(|prism| sight.past_prism(prism)));
        edges.max_by(|a, b| a.reach.total_cmp(&b.reach))
    }
}

/// The sight line.
struct AirPath {
    base: Vector3<f64>,
    vehicle: Vector3<f64>,
}

impl AirPath {
    fn plan(&self) -> [Vector2<f64>; 2] {
        [self.base.xy(), self.vehicle.xy()]
    }

    /// The edge at part `t` in [0, 1] of the way.
    fn edge(&self, t: f64, reach: f64) -> BlockingEdge {
        let d = (self.vehicle - self.base).norm();
        BlockingEdge { reach, ends: [t * d, (1.0 - t) * d] }
    }

    fn height(&self, t: f64) -> f64 {
        self.base.z + t * (self.vehicle.z - self.base.z)
    }

    fn past_disc(&self, disc: &DiscObstacle) -> BlockingEdge {
        let [base, vehicle] = self.plan();
        let centre = Vector2::from(disc.centre);
        let way = vehicle - base;
        let t = (way.dot(&(centre - base)) / way.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        let side = disc.radius_m - distance_to_sight_line(vehicle, centre, base);
        let top = disc.height_m.map_or(f64::INFINITY, |height| height - self.height(t));
        self.edge(t, side.min(top))
    }

    fn past_prism(&self, prism: &Prism) -> BlockingEdge {
        let [base, vehicle] = self.plan();
        let corners: Vec<Vector2<f64>> = prism.corners.iter().copied().map(Vector2::from).collect();
        let Some((enters, leaves)) = crossing(base, vehicle, &corners) else {
            let (t, distance) = nearest(base, vehicle, &corners);
            return self.edge(t, -distance);
        };
        // Over the roof, where the line is lowest, or around the corner that is farthest out on either side.
        let lowest = if self.height(enters) < self.height(leaves) { enters } else { leaves };
        let way = (vehicle - base).normalize();
        let out = corners.iter().map(|corner| way.perp(&(corner - base)));
        let (left, right) = out.fold((0.0_f64, 0.0_f64), |(l, r), x| (l.max(x), r.max(-x)));
        let top = prism.height_m - self.height(lowest);
        if top < left.min(right) {
            return self.edge(lowest, top);
        }
        self.edge(0.5 * (enters + leaves), left.min(right))
    }
}

/// The parts of the segment at which it is first and last inside a polygon, or `None`.
fn crossing(a: Vector2<f64>, b: Vector2<f64>, corners: &[Vector2<f64>]) -> Option<(f64, f64)> {
    let way = b - a;
    let cuts = sides(corners).filter_map(|(p, q)| {
        let side = q - p;
        let cross = way.perp(&side);
        let (t, u) = ((p - a).perp(&side) / cross, (p - a).perp(&way) / cross);
        ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some(t)
    });
    let ends = [(a, 0.0), (b, 1.0)].into_iter().filter(|(end, _)| inside(*end, corners)).map(|(_, t)| t);
    let (first, last) = cuts
        .chain(ends)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), t| (first.min(t), last.max(t)));
    (first <= last && way.norm() > 1e-9).then_some((first, last))
}

fn sides(corners: &[Vector2<f64>]) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> {
    (0..corners.len()).map(|k| (corners[k], corners[(k + 1) % corners.len()]))
}

/// Whether a ray to the north crosses an odd number of sides.
fn inside(point: Vector2<f64>, corners: &[Vector2<f64>]) -> bool {
    let crosses = |(p, q): (Vector2<f64>, Vector2<f64>)| {
        (p.y > point.y) != (q.y > point.y) && point.x < p.x + (point.y - p.y) / (q.y - p.y) * (q.x - p.x)
    };
    sides(corners).filter(|side| crosses(*side)).count() % 2 == 1
}

/// The part of the segment that is nearest to a polygon which it does not cross, and how far it is.
fn nearest(a: Vector2<f64>, b: Vector2<f64>, corners: &[Vector2<f64>]) -> (f64, f64) {
    let along = |point: Vector2<f64>| {
        let t = ((b - a).dot(&(point - a)) / (b - a).norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (t, (point - (a + t * (b - a))).norm())
    };
    let at_corner = corners.iter().map(|corner| along(*corner));
    let at_end = [(a, 0.0), (b, 1.0)]
        .into_iter()
        .flat_map(|(end, t)| sides(corners).map(move |(p, q)| (t, distance_to_sight_line(q, end, p))));
    at_corner.chain(at_end).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.5, f64::INFINITY))
}

/// Why a file holds no buildings.
#[derive(Debug, thiserror::Error)]
pub enum BuildingsError {
    /// It cannot be read.
    #[error("reading {path}: {source}")]
    Read {
        /// Which.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// It is no GeoJSON.
    #[error("{path}: {why}")]
    Parse {
        /// Which.
        path: String,
        /// What is wrong.
        why: String,
    },
}

/// Height of a storey where a building tells only their number, m.
const STOREY_M: f64 = 3.0;

/// The buildings of a GeoJSON file (RFC 7946): the outer rings of its polygons. Their height is the property
/// `height` in m, else 3 m for each of `building:levels`, else `default_height_m`. `origin` is the latitude and
/// the longitude of north 0, east 0, in degrees.
///
/// # Errors
/// The file cannot be read or holds no features.
pub fn buildings(path: &Path, origin: [f64; 2], default_height_m: f64) -> Result<Vec<Prism>, BuildingsError> {
    let name = || path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|source| BuildingsError::Read { path: name(), source })?;
    geojson(&text, origin, default_height_m).map_err(|why| BuildingsError::Parse { path: name(), why })
}

fn geojson(text: &str, origin: [f64; 2], default_height_m: f64) -> Result<Vec<Prism>, String> {
    let json: serde_json::Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let features = json["features"].as_array().ok_or("no FeatureCollection of RFC 7946")?;
    let mut prisms = Vec::new();
    for feature in features {
        let shape = &feature["geometry"];
        let rings: Vec<&serde_json::Value> = match shape["type"].as_str() {
            Some("Polygon") => vec![&shape["coordinates"][0]],
            Some("MultiPolygon") => {
                shape["coordinates"].as_array().into_iter().flatten().map(|polygon| &polygon[0]).collect()
            }
            _ => continue,
        };
        let height_m = height(&feature["properties"]).unwrap_or(default_height_m);
        for ring in rings {
            let corners = ring.as_array().into_iter().flatten().map(|place| corner(place, origin));
            let mut corners = corners.collect::<Result<Vec<_>, _>>()?;
            // A ring ends where it began.
            if corners.len() > 1 && corners.first() == corners.last() {
                corners.pop();
            }
            if corners.len() < 3 {
                return Err("a ring of fewer than three corners".into());
            }
            prisms.push(Prism { corners, height_m });
        }
    }
    Ok(prisms)
}

/// A number, or a text that begins with one, as OpenStreetMap has both.
fn number(value: &serde_json::Value) -> Option<f64> {
    let text = |text: &str| text.split([' ', 'm']).next().and_then(|number| number.parse().ok());
    value.as_f64().or_else(|| value.as_str().and_then(text)).filter(|x: &f64| x.is_finite() && *x >= 0.0)
}

fn height(properties: &serde_json::Value) -> Option<f64> {
    let levels = || number(&properties["building:levels"]).map(|levels| levels * STOREY_M);
    number(&properties["height"]).or_else(levels)
}

fn corner(place: &serde_json::Value, origin: [f64; 2]) -> Result<[f64; 2], String> {
    match (place[0].as_f64(), place[1].as_f64()) {
        (Some(longitude), Some(latitude)) => Ok(earth::north_east(origin, [latitude, longitude])),
        _ => Err(format!("no place: {place}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn house(height_m: f64) -> Surroundings {
        let corners = vec![[40.0, -10.0], [40.0, 10.0], [60.0, 10.0], [60.0, -10.0]];
        Surroundings::new(Vec::new(), vec![Prism { corners, height_m }])
    }

    fn worst(around: &Surroundings, base: [f64; 3], vehicle: [f64; 3]) -> BlockingEdge {
        around.worst(base.into(), vehicle.into()).unwrap()
    }

    /// J(ν) of ITU-R P.526-15, Fig. 9 and Eq. (31).
    #[test]
    fn a_knife_edge_is_itu_r_p_526() {
        for (nu, published) in [(-1.0, 0.0), (0.0, 6.03), (1.0, 13.93), (2.4, 20.55), (10.0, 32.9)] {
            assert!((knife_edge(nu) - published).abs() < 0.1, "{nu}: {}", knife_edge(nu));
        }
        // P.526, Eq. (26): 10 m over the line in the middle of 2 km at 300 MHz: ν = 10 √(2 / 0.99931 * 0.002).
        let edge = BlockingEdge { reach: 10.0, ends: [1e3, 1e3] };
        assert!((edge.fresnel(300e6) - 0.6327).abs() < 1e-3, "{}", edge.fresnel(300e6));
    }

    #[test]
    fn a_house_in_the_way_obstructs_by_its_nearest_edge() {
        let low = worst(&house(20.0), [0.0, 0.0, 10.0], [100.0, 0.0, 10.0]);
        assert_eq!(
            (low.reach, low.ends),
            (10.0, [50.0, 50.0]),
            "around its sides, which are as near as the roof"
        );
        let roof = worst(&house(12.0), [0.0, 0.0, 10.0], [100.0, 0.0, 10.0]);
        assert!((roof.reach - 2.0).abs() < 1e-9 && (roof.ends[0] - 60.0).abs() < 1e-9, "{roof:?}");
        let over = worst(&house(20.0), [0.0, 0.0, 10.0], [100.0, 0.0, 60.0]);
        assert!((over.reach + 10.0).abs() < 1e-9, "{over:?}");
        let beside = worst(&house(20.0), [0.0, 25.0, 10.0], [100.0, 25.0, 10.0]);
        assert!((beside.reach + 15.0).abs() < 1e-9, "{beside:?}");
        let short = worst(&house(20.0), [0.0, 0.0, 10.0], [30.0, 0.0, 10.0]);
        assert!((short.reach + 10.0).abs() < 1e-9, "{short:?}");
        // Above its own roof: the line leaves through the roof's edge.
        let inside = worst(&house(20.0), [0.0, 0.0, 2.0], [50.0, 0.0, 10.0]);
        assert!(inside.reach > 0.0, "{inside:?}");
    }

    #[test]
    fn a_disc_obstructs_from_the_side_and_from_below() {
        let disc = DiscObstacle { centre: [50.0, 3.0], radius_m: 5.0, height_m: None };
        let around = Surroundings::new(vec![disc], Vec::new());
        assert!((worst(&around, [0.0, 0.0, 5.0], [100.0, 0.0, 5.0]).reach - 2.0).abs() < 1e-9);
        let stump = Surroundings::new(vec![DiscObstacle { height_m: Some(6.0), ..disc }], Vec::new());
        assert!((worst(&stump, [0.0, 0.0, 5.0], [100.0, 0.0, 5.0]).reach - 1.0).abs() < 1e-9);
        assert_eq!(Surroundings::default().worst(Vector3::zeros(), Vector3::x()), None);
    }

    #[test]
    fn the_soft_shadow_is_the_paper_s() {
        use crate::Scenario;
        use crate::world::channel;
        let channel = Scenario::default().channel;
        let (uav, obstacle) = (Vector2::new(0.52, 0.8), Vector2::new(0.5, 0.45));
        let ratio = channel::gain(uav, obstacle, 0.1, &channel) / channel::los_gain(uav, &channel);
        // North is y, east is x; 500 m are one unit.
        let ned = |r: Vector2<f64>| [500.0 * r.y, 500.0 * r.x];
        let disc = DiscObstacle { centre: ned(obstacle), radius_m: 50.0, height_m: None };
        let around = Surroundings::new(vec![disc], Vec::new());
        let [base, vehicle] = [channel.base_station, uav].map(|r| [ned(r)[0], ned(r)[1], 100.0]);
        let soft = BlockageLoss::Soft { attenuation: channel.nlos_attenuation, softness_m: 10.0 };
        let loss = soft.db(&worst(&around, base, vehicle), 1e9);
        assert!((loss + 10.0 * ratio.log10()).abs() < 1e-9, "{loss}");
    }

    #[test]
    fn buildings_come_from_geojson_with_their_heights() {
        let feature = |properties: &str, coordinates: &str| {
            format!(
                r#"{{"type":"Feature","properties":{properties},"geometry":{{"type":"Polygon","coordinates":[{coordinates}]}}}}"#
            )
        };
        let ring = "[[8.0,47.0],[8.0,47.001],[8.001,47.001],[8.0,47.0]]";
        let features = [
            feature(r#"{"height":"12.5 m"}"#, ring),
            feature(r#"{"building:levels":4}"#, ring),
            feature("{}", ring),
        ];
        let text = format!(r#"{{"type":"FeatureCollection","features":[{}]}}"#, features.join(","));
        let prisms = geojson(&text, [47.0, 8.0], 8.0).unwrap();
        assert_eq!(prisms.iter().map(|p| p.height_m).collect::<Vec<_>>(), [12.5, 12.0, 8.0]);
        assert_eq!(prisms[0].corners.len(), 3);
        assert!((prisms[0].corners[1][0] - 111.3).abs() < 0.1, "{:?}", prisms[0]);
        assert!(geojson("{}", [0.0; 2], 1.0).unwrap_err().contains("FeatureCollection"));
        let flat = text.replace(ring, "[[8.0,47.0],[8.0,47.001]]");
        assert!(geojson(&flat, [47.0, 8.0], 1.0).unwrap_err().contains("three corners"));
        let bent = text.replace("[8.0,47.0]", "[\"x\",47.0]");
        assert!(geojson(&bent, [47.0, 8.0], 1.0).unwrap_err().contains("no place"));
    }
}
