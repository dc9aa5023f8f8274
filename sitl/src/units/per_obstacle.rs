//! One value for each obstacle: a short list that is copied like an array.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Maximum number of obstacles in a scenario. The wire allows nine: the name of a DEBUG_VECT has ten
/// characters, and `OBSTACLE_9` is the last one that fits.
pub const MAX_OBSTACLES: usize = 8;

/// One value for each obstacle, in the scenario's order: a list of at most [`MAX_OBSTACLES`] that is
/// copied like an array and read like a slice.
#[derive(Clone, Copy)]
pub struct PerObstacle<T> {
    items: [T; MAX_OBSTACLES],
    len: usize,
}

/// Centres of the obstacles r_u, paper units.
pub type Obstacles = PerObstacle<Vector2<f64>>;

impl<T: Copy + Default> FromIterator<T> for PerObstacle<T> {
    /// Values beyond [`MAX_OBSTACLES`] are left out; [`crate::Scenario::check`] refuses so many obstacles.
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut list = Self::default();
        for (slot, value) in list.items.iter_mut().zip(values) {
            *slot = value;
            list.len += 1;
        }
        list
    }
}

impl<T: Copy + Default, const N: usize> From<[T; N]> for PerObstacle<T> {
    fn from(values: [T; N]) -> Self {
        values.into_iter().collect()
    }
}

impl<T: Copy + Default> Default for PerObstacle<T> {
    fn default() -> Self {
        Self { items: [T::default(); MAX_OBSTACLES], len: 0 }
    }
}

impl<T> std::ops::Deref for PerObstacle<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.items[..self.len]
    }
}

impl<T> std::ops::DerefMut for PerObstacle<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items[..self.len]
    }
}

impl<T: PartialEq> PartialEq for PerObstacle<T> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl<T: std::fmt::Debug> std::fmt::Debug for PerObstacle<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self[..].fmt(f)
    }
}

impl<T: Serialize> Serialize for PerObstacle<T> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self[..].serialize(serializer)
    }
}

impl<'de, T: Copy + Default + Deserialize<'de>> Deserialize<'de> for PerObstacle<T> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let values = Vec::<T>::deserialize(deserializer)?;
        if values.len() > MAX_OBSTACLES {
            return Err(serde::de::Error::invalid_length(values.len(), &"at most 8 obstacles"));
        }
        Ok(values.into_iter().collect())
    }
}
