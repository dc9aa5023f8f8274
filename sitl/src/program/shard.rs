//! One machine's share of a computation whose parts do not depend on each other.

use std::fmt;
use std::str::FromStr;

/// Shard I of N, I from 1: the parts whose number, counted from 0, leaves the remainder I - 1. Every shard has parts of
/// the whole range, so shards take equally long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// I, from 1.
    pub number: u64,
    /// N.
    pub of: u64,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Whether part `n`, counted from 0, is in it.
    #[must_use]
    pub fn has(self, n: u64) -> bool {
        n % self.of == self.number - 1
    }

    /// Why these are not all shards of one computation, each once; `None` if they are. Each has a name to be told by.
    #[must_use]
    pub fn lack(shards: &[(String, Self)]) -> Option<String> {
        let Some((first_name, first)) = shards.first() else { return Some("no shard".into()) };
        for (n, (name, shard)) in shards.iter().enumerate() {
            if shard.of != first.of {
                return Some(format!(
                    "{first_name} is shard {first} and {name} is shard {shard}: of different numbers"
                ));
            }
            if let Some((twin, _)) = shards[..n].iter().find(|(_, before)| before == shard) {
                return Some(format!("{twin} and {name} both hold shard {shard}"));
            }
        }
        let of = first.of;
        let is_there = |number: &u64| shards.iter().any(|(_, shard)| shard.number == *number);
        let missing: Vec<String> =
            (1..=of).filter(|n| !is_there(n)).take(10).map(|n| format!("{n}/{of}")).collect();
        (!missing.is_empty()).then(|| format!("missing: shard {}", missing.join(", ")))
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Self { number, of }),
            _ => Err("must be I/N with I from 1 to N, such as 1/3".into()),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shard(text: &str) -> Shard {
        text.parse().unwrap()
    }

    #[test]
    fn shards_part_what_there_is() {
        let mine = |text: &str| (0..8).filter(|n| shard(text).has(*n)).collect::<Vec<_>>();
        assert_eq!([mine("1/3"), mine("2/3"), mine("3/3")], [vec![0, 3, 6], vec![1, 4, 7], vec![2, 5]]);
        for text in ["0/3", "4/3", "1", "a/b", "1/0", "/"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }

    #[test]
    fn what_is_missing_or_there_twice_is_told() {
        let lack = |all: &[&str]| {
            let named: Vec<_> =
                all.iter().enumerate().map(|(n, text)| (n.to_string(), shard(text))).collect();
            Shard::lack(&named).unwrap_or_default()
        };
        assert_eq!(lack(&["2/2", "1/2"]), "");
        assert_eq!(lack(&["2/3"]), "missing: shard 1/3, 3/3");
        assert_eq!(lack(&["1/2", "2/2", "1/2"]), "0 and 2 both hold shard 1/2");
        assert_eq!(lack(&["1/2", "2/3"]), "0 is shard 1/2 and 1 is shard 2/3: of different numbers");
        assert_eq!(lack(&[]), "no shard");
    }
}
