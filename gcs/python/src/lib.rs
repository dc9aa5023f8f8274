//! `_crpl`, the compiled part of the Python package `crpl`: numpy arrays in, numpy arrays out.
//!
//! Every loop over flights or pictures runs here, in one call, without Python's lock. What is computed is `crpl_gcs`'s
//! and `crpl_model`'s; nothing here knows physics.

mod arrays;
mod fleets;
mod flights;
mod lab;
mod world;

/// The compiled part of the package `crpl`.
#[pyo3::pymodule]
mod _crpl {
    #[pymodule_export]
    use super::fleets::Fleet;
    #[pymodule_export]
    use super::flights::Flights;
    #[pymodule_export]
    use super::lab::{
        claim, explore, fly, mean, metrics, presets, ratio, records, revision, scenario, wilson,
    };
    #[pymodule_export]
    use super::world::{NetworkPolicy, Observer, WorldModel};
}
