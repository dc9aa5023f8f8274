//! One flight of a sweep as a line of a table: flown, written, read.

use std::str::FromStr;

use anyhow::{Context, Result, bail};
use clap::ValueEnum;

use crate::lab::parquet::{Column, Values};
use crate::lab::{Contender, Scored};
use crate::station::pilot::Controller;

/// One flight's score.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Value of the sweep's axis.
    pub x: f64,
    /// Who flew.
    pub controller: Controller,
    /// Seed of the disturbance.
    pub seed: u64,
    /// What came of it.
    pub scored: Outcome,
}

/// The figures of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// d_f, units.
    pub d_f: f64,
    /// E_comm.
    pub e_comm: f64,
    /// E_ctrl, J.
    pub e_ctrl: f64,
    /// p_coll^max.
    pub p_coll_max: f64,
    /// Intervals in outage.
    pub t_out: u64,
    /// Whether it ended in the goal region.
    pub reached: bool,
    /// Whether it passed below the obstacle.
    pub below: bool,
    /// Whether it ended at a wall.
    pub at_wall: bool,
}

impl From<&Scored> for Outcome {
    fn from(scored: &Scored) -> Self {
        let m = &scored.metrics;
        Self {
            d_f: m.d_f,
            e_comm: m.e_comm,
            e_ctrl: m.e_ctrl,
            p_coll_max: m.p_coll_max,
            t_out: m.t_out,
            reached: m.reached,
            below: scored.below,
            at_wall: scored.at_wall,
        }
    }
}

impl Episode {
    /// The table's head.
    pub const HEAD: &str = "x,controller,seed,d_f,e_comm,e_ctrl,p_coll_max,t_out,reached,below,at_wall";

    /// Flies it: a pure function of contender, point and seed.
    pub fn fly(contender: &Contender, x: f64, seed: u64) -> Result<Self> {
        let scored = contender.fly(seed)?;
        Ok(Self { x, controller: contender.controller, seed, scored: Outcome::from(&scored) })
    }

    /// One line without its end. Numbers are written so that they read back as the same number.
    #[must_use]
    pub fn line(&self) -> String {
        let o = &self.scored;
        format!(
            "{},{},{},{},{},{},{},{},{},{},{}",
            self.x,
            self.controller,
            self.seed,
            o.d_f,
            o.e_comm,
            o.e_ctrl,
            o.p_coll_max,
            o.t_out,
            o.reached,
            o.below,
            o.at_wall
        )
    }

    /// The table's columns.
    #[must_use]
    pub fn columns<'a>(episodes: &[Self], names: &'a [String]) -> Vec<Column<'a>> {
        let reals = |of: fn(&Outcome) -> f64| Values::Reals(episodes.iter().map(|e| of(&e.scored)).collect());
        let booleans =
            |of: fn(&Outcome) -> bool| Values::Booleans(episodes.iter().map(|e| of(&e.scored)).collect());
        let column = |name, values| Column { name, values };
        vec![
            column("x", Values::Reals(episodes.iter().map(|e| e.x).collect())),
            column("controller", Values::Texts(names.iter().map(String::as_str).collect())),
            column("seed", Values::Integers(episodes.iter().map(|e| e.seed as i64).collect())),
            column("d_f", reals(|o| o.d_f)),
            column("e_comm", reals(|o| o.e_comm)),
            column("e_ctrl", reals(|o| o.e_ctrl)),
            column("p_coll_max", reals(|o| o.p_coll_max)),
            column("t_out", Values::Integers(episodes.iter().map(|e| e.scored.t_out as i64).collect())),
            column("reached", booleans(|o| o.reached)),
            column("below", booleans(|o| o.below)),
            column("at_wall", booleans(|o| o.at_wall)),
        ]
    }
}

impl FromStr for Episode {
    type Err = anyhow::Error;

    fn from_str(line: &str) -> Result<Self> {
        let cells: Vec<&str> = line.split(',').collect();
        let [x, controller, seed, d_f, e_comm, e_ctrl, p_coll_max, t_out, reached, below, at_wall] =
            cells[..]
        else {
            bail!("{} columns instead of 11", cells.len());
        };
        let controller = Controller::from_str(controller, false)
            .ok()
            .with_context(|| format!("no controller is called {controller:?}"))?;
        Ok(Self {
            x: cell("x", x)?,
            controller,
            seed: cell("seed", seed)?,
            scored: Outcome {
                d_f: cell("d_f", d_f)?,
                e_comm: cell("e_comm", e_comm)?,
                e_ctrl: cell("e_ctrl", e_ctrl)?,
                p_coll_max: cell("p_coll_max", p_coll_max)?,
                t_out: cell("t_out", t_out)?,
                reached: cell("reached", reached)?,
                below: cell("below", below)?,
                at_wall: cell("at_wall", at_wall)?,
            },
        })
    }
}

fn cell<T: FromStr>(name: &str, text: &str) -> Result<T> {
    text.parse().ok().with_context(|| format!("{name} = {text:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_line_that_is_none_says_why() {
        let error = |line: &str| line.parse::<Episode>().unwrap_err().to_string();
        assert_eq!(error("2.5,rcc,1"), "3 columns instead of 11");
        assert_eq!(error("2.5,nobody,1,0,0,0,0,0,true,true,true"), "no controller is called \"nobody\"");
        assert_eq!(error("2.5,rcc,1,0,x,0,0,0,true,true,true"), "e_comm = \"x\"");
    }

    proptest! {
        #[test]
        fn a_line_reads_back_as_the_same_bits(
            x in proptest::num::f64::NORMAL, d_f in 0.0..2.0f64, e_ctrl in 0.0..1e5f64,
            p_coll_max in 0.0..1.0f64, seed: u64, t_out in 0..101u64, reached: bool,
        ) {
            let scored = Outcome {
                d_f, e_comm: 148.0, e_ctrl, p_coll_max, t_out, reached, below: !reached, at_wall: false,
            };
            let episode = Episode { x, controller: Controller::Ucc, seed, scored };
            prop_assert_eq!(episode.line().parse::<Episode>().unwrap(), episode);
        }
    }
}
