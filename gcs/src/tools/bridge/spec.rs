//! An endpoint of the bridge with what is asked of it: `ENDPOINT?group=NAME&rate=BYTES`.

use std::fmt;
use std::str::FromStr;

use crpl_sitl::link::endpoint::{Endpoint, NoEndpoint};
use crpl_sitl::link::message_id;

use super::router::rules::LinkRules;

/// An endpoint and its rules.
#[derive(Debug, Clone, PartialEq)]
pub struct EndpointSpec {
    /// Where.
    pub endpoint: Endpoint,
    /// What is asked of it.
    pub rules: LinkRules,
}

/// Not an endpoint with rules.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoSpec {
    /// What stands before the question mark is no endpoint.
    #[error(transparent)]
    Endpoint(#[from] NoEndpoint),
    /// A rule that is not known.
    #[error(
        "`{0}` is no rule of an endpoint; there are group, rate, only, drop, only-from, drop-from and renumber"
    )]
    Rule(String),
    /// Neither the name of a message nor its number.
    #[error("`{0}` is no message's name or number")]
    Message(String),
    /// Neither yes nor no.
    #[error("`{0}` is neither yes nor no")]
    Answer(String),
    /// Not a rate.
    #[error("`{0}` is no rate: bytes a second, above 0")]
    Rate(String),
}

impl FromStr for EndpointSpec {
    type Err = NoSpec;

    fn from_str(text: &str) -> Result<Self, NoSpec> {
        let (endpoint, asked) = text.split_once('?').unwrap_or((text, ""));
        let mut rules = LinkRules::default();
        for rule in asked.split('&').filter(|rule| !rule.is_empty()) {
            let (key, value) = rule.split_once('=').ok_or_else(|| NoSpec::Rule(rule.into()))?;
            match key {
                "group" => rules.group = Some(value.into()),
                "rate" => rules.rate = Some(rate(value)?),
                "only" => rules.only = messages(value)?,
                "drop" => rules.drop = messages(value)?,
                "only-from" => rules.only_from = messages(value)?,
                "drop-from" => rules.drop_from = messages(value)?,
                "renumber" => rules.renumber = yes(value)?,
                _ => return Err(NoSpec::Rule(rule.into())),
            }
        }
        Ok(Self { endpoint: endpoint.parse()?, rules })
    }
}

impl fmt::Display for EndpointSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.endpoint.fmt(f)
    }
}

fn rate(text: &str) -> Result<f64, NoSpec> {
    let rate = text.parse().ok().filter(|rate: &f64| rate.is_finite() && *rate > 0.0);
    rate.ok_or_else(|| NoSpec::Rate(text.into()))
}

fn yes(text: &str) -> Result<bool, NoSpec> {
    match text {
        "yes" => Ok(true),
        "no" => Ok(false),
        _ => Err(NoSpec::Answer(text.into())),
    }
}

fn messages(text: &str) -> Result<Vec<u32>, NoSpec> {
    text.split(',').map(|name| message_id(name).ok_or_else(|| NoSpec::Message(name.into()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_stand_behind_the_endpoint() {
        let spec: EndpointSpec =
            "serial:/dev/ttyUSB0:57600?group=radio&rate=2000&drop=ATTITUDE,105&only-from=heartbeat&renumber=yes"
                .parse()
                .unwrap();
        let expected = LinkRules {
            group: Some("radio".into()),
            rate: Some(2000.0),
            drop: vec![30, 105],
            only_from: vec![0],
            renumber: true,
            ..LinkRules::default()
        };
        assert_eq!((spec.to_string().as_str(), &spec.rules), ("serial:/dev/ttyUSB0:57600", &expected));
        let plain: EndpointSpec = "udpin:127.0.0.1:14550".parse().unwrap();
        assert_eq!(plain.rules, LinkRules::default());
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line() {
        for (text, why) in [
            ("udpin::1?speed=3", "`speed=3` is no rule"),
            ("udpin::1?group", "`group` is no rule"),
            ("udpin::1?rate=-1", "`-1` is no rate"),
            ("udpin::1?rate=1e999", "`1e999` is no rate"),
            ("udpin::1?drop=NO_SUCH", "`NO_SUCH` is no message"),
            ("udpin::1?renumber=1", "neither yes nor no"),
            ("can:can0?rate=3", "is no endpoint"),
        ] {
            let error = text.parse::<EndpointSpec>().unwrap_err().to_string();
            assert!(error.contains(why) && !error.contains('\n'), "{error}");
        }
    }
}
