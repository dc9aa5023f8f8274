//! The recipe that makes a world model, and its pieces. [`recipe`] reads from top to bottom.
//!
//! All but `bounds`, `closed_form`, `flags`, `learned`, `stages`, `predictors` and `show` need burn: the cargo feature `train`.

#[cfg(feature = "train")]
pub mod ablation;
#[cfg(feature = "train")]
pub mod ablation_command;
pub mod bounds;
#[cfg(feature = "train")]
pub mod cache;
pub mod closed_form;
#[cfg(feature = "train")]
pub mod collect_command;
#[cfg(feature = "train")]
pub mod fitting;
pub mod flags;
#[cfg(feature = "train")]
pub mod gradient;
#[cfg(feature = "train")]
pub mod heads;
pub mod learned;
#[cfg(feature = "train")]
pub mod losses;
pub mod predictors;
#[cfg(feature = "train")]
pub mod recipe;
pub mod show;
