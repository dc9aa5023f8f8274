//! Buildings on a map: the polygons of a GeoJSON file.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;
use serde_json::{Value, json};

use super::feed::rounded;

/// Corners of all buildings: more make a page heavy.
const CORNERS: usize = 20_000;

/// Bytes of a file.
const BYTES: u64 = 64 << 20;

/// Decimals of a degree: centimetres.
const DIGITS: i32 = 7;

/// The flag of a page with a map.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct MapFlags {
    /// Show these buildings on the page's map: a GeoJSON file with polygons
    #[arg(help_heading = "Page", long, value_name = "FILE", requires = "watch")]
    pub buildings: Option<PathBuf>,
}

impl MapFlags {
    /// The buildings, if some are wanted.
    ///
    /// # Errors
    /// As [`buildings`].
    pub fn load(&self) -> Result<Option<Value>> {
        self.buildings.as_deref().map(buildings).transpose()
    }
}

/// How a field lies on Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldPlace {
    /// Latitude and longitude of its (0, 0), degrees.
    pub origin: [f64; 2],
    /// From north to its up, degrees clockwise.
    pub heading: f64,
}

/// A ring of positions: longitude, latitude, and what else a file gives.
type Ring = Vec<Vec<f64>>;

/// What of GeoJSON can hold polygons.
#[derive(Debug, Deserialize)]
#[serde(tag = "type")]
enum GeoShape {
    FeatureCollection {
        features: Vec<GeoShape>,
    },
    Feature {
        geometry: Option<Box<GeoShape>>,
    },
    GeometryCollection {
        geometries: Vec<GeoShape>,
    },
    Polygon {
        coordinates: Vec<Ring>,
    },
    MultiPolygon {
        coordinates: Vec<Vec<Ring>>,
    },
    #[serde(other)]
    Other,
}

impl GeoShape {
    fn polygons(self, found: &mut Vec<Vec<Ring>>) {
        match self {
            Self::FeatureCollection { features: all } | Self::GeometryCollection { geometries: all } => {
                all.into_iter().for_each(|shape| shape.polygons(found));
            }
            Self::Feature { geometry } => {
                if let Some(shape) = geometry {
                    shape.polygons(found);
                }
            }
            Self::Polygon { coordinates } => found.push(coordinates),
            Self::MultiPolygon { coordinates } => found.extend(coordinates),
            Self::Other => {}
        }
    }
}

/// All polygons of a GeoJSON file as one MultiPolygon.
///
/// # Errors
/// A file that does not read, holds no polygon, or holds too much.
pub fn buildings(path: &Path) -> Result<Value> {
    let name = || format!("--buildings {}", path.display());
    let size = std::fs::metadata(path).with_context(name)?.len();
    ensure!(size <= BYTES, "{}: more than {} MB", name(), BYTES >> 20);
    let text = std::fs::read(path).with_context(name)?;
    polygons(&text).with_context(name)
}

fn polygons(text: &[u8]) -> Result<Value> {
    let shape: GeoShape = serde_json::from_slice(text).context("not GeoJSON")?;
    let mut found = Vec::new();
    shape.polygons(&mut found);
    let corners: usize = found.iter().flatten().map(Vec::len).sum();
    if corners == 0 {
        bail!("no polygon in it");
    }
    ensure!(corners <= CORNERS, "{corners} corners, at most {CORNERS}: cut out what is near the flight");
    for position in found.iter_mut().flatten().flatten() {
        let &[longitude, latitude, ..] = &position[..] else { bail!("a position without two numbers") };
        ensure!(
            longitude.abs() <= 180.0 && latitude.abs() <= 90.0,
            "{longitude}, {latitude} is no longitude and latitude in degrees"
        );
        *position = vec![rounded(longitude, DIGITS), rounded(latitude, DIGITS)];
    }
    Ok(json!({ "type": "MultiPolygon", "coordinates": found }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_are_found_wherever_they_are() {
        let ring = "[[8.1,47,430],[8.2,47,430],[8.2,47.1,430],[8.1,47,430]]";
        let text = format!(
            r#"{{"type":"FeatureCollection","features":[
              {{"type":"Feature","properties":{{"levels":3}},"geometry":{{"type":"Polygon","coordinates":[{ring}]}}}},
              {{"type":"Feature","properties":null,"geometry":null}},
              {{"type":"Feature","geometry":{{"type":"Point","coordinates":[8,47]}}}},
              {{"type":"Feature","geometry":{{"type":"MultiPolygon","coordinates":[[{ring}],[{ring},{ring}]]}}}}]}}"#
        );
        let told = polygons(text.as_bytes()).unwrap();
        let rings: usize =
            told["coordinates"].as_array().unwrap().iter().map(|p| p.as_array().unwrap().len()).sum();
        assert_eq!((rings, &told["coordinates"][0][0][1]), (4, &json!([8.2, 47.0])));
    }

    #[test]
    fn what_is_no_building_is_told() {
        for (text, told) in [
            ("{", "not GeoJSON"),
            (r#"{"type":"Point","coordinates":[1,2]}"#, "no polygon"),
            (r#"{"type":"Polygon","coordinates":[[[1]]]}"#, "two numbers"),
            (r#"{"type":"Polygon","coordinates":[[[683000,247000]]]}"#, "no longitude"),
        ] {
            let error = polygons(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
    }
}
