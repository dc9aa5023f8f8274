//! From numpy arrays to slices and back, by Python's buffer protocol; errors as Python's `ValueError`.
//!
//! Values are copied in and out: what runs without Python's lock must be nobody else's.

use crpl_sitl::Scenario;
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// What is wrong, as `ValueError`.
pub fn wrong(error: impl Into<anyhow::Error>) -> PyErr {
    PyValueError::new_err(format!("{:#}", error.into()))
}

/// A `ValueError` with this text.
pub fn refuse<T>(text: String) -> PyResult<T> {
    Err(PyValueError::new_err(text))
}

/// The scenario of a preset's name, a TOML file, or a JSON object.
pub fn scenario_of(text: &str) -> PyResult<Scenario> {
    if !text.trim_start().starts_with('{') {
        return Scenario::named(text).map_err(wrong);
    }
    let scenario: Scenario = serde_json::from_str(text).map_err(wrong)?;
    scenario.check().map_err(wrong)?;
    Ok(scenario)
}

/// The values of an array whose shape is `[n, tail...]`, and n.
pub fn rows<T: Element>(
    py: Python<'_>,
    name: &str,
    array: &PyBuffer<T>,
    tail: &[usize],
) -> PyResult<(Vec<T>, usize)> {
    match array.shape() {
        [n, rest @ ..] if rest == tail => Ok((array.to_vec(py)?, *n)),
        shape => refuse(format!("{name} has shape {shape:?}, not [N, {tail:?}]")),
    }
}

/// As [`rows`], of exactly `n` of them.
pub fn rows_of<T: Element>(
    py: Python<'_>,
    name: &str,
    array: &PyBuffer<T>,
    n: usize,
    tail: &[usize],
) -> PyResult<Vec<T>> {
    let (values, there) = rows(py, name, array, tail)?;
    if there == n { Ok(values) } else { refuse(format!("{name} has {there} rows, not {n}")) }
}

/// Copies values into an array of as many.
pub fn fill<T: Element>(py: Python<'_>, out: &PyBuffer<T>, values: &[T]) -> PyResult<()> {
    if out.item_count() != values.len() {
        return refuse(format!("an array of {} values cannot take {}", out.item_count(), values.len()));
    }
    out.copy_from_slice(py, values)
}
