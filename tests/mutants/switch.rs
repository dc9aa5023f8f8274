//! Which mutant is on, by the variable MUTANT. Put into the copy of the sources by `tests/mutants/run`, never here.

use std::fs::OpenOptions;
use std::io::Write;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};

/// A number, or `reach`: then each mutant that is met is written down in the file REACH names.
static CHOSEN: LazyLock<String> = LazyLock::new(|| std::env::var("MUTANT").unwrap_or_default());
static WHICH: LazyLock<i64> = LazyLock::new(|| CHOSEN.parse().unwrap_or(if *CHOSEN == "reach" { -2 } else { -1 }));
static MET: [AtomicBool; 4000] = [const { AtomicBool::new(false) }; 4000];

#[inline]
pub fn is(mutant: i64) -> bool {
    let which = *WHICH;
    if which == -2 {
        met(mutant);
    }
    which == mutant
}

#[cold]
#[inline(never)]
fn met(mutant: i64) {
    if !MET[mutant as usize].swap(true, Ordering::Relaxed) {
        let path = std::env::var("REACH").unwrap();
        let mut file = OpenOptions::new().append(true).create(true).open(path).unwrap();
        file.write_all(format!("{mutant}\n").as_bytes()).unwrap();
    }
}
