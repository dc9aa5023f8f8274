//! A ground station that flies a UAV from pictures.
//!
//! ```text
//! Percept --> Station: encode --> Belief --> Pilot --> Command      (sans-IO)
//!    ^                                                     |
//!    +---------- fly: UDP, MAVLink, tlog ------------------+
//! ```
//!
//! | module | what it is | what it does not know |
//! |---|---|---|
//! | [`station`] | percept in, command out, idempotent | sockets, clocks |
//! | [`belief`] | latent history, ledger of commands | physics |
//! | [`pilot`] | CRPL, APC, RCC, UCC: who sees what | bytes |
//! | [`remote`] | datagrams to percepts, commands to datagrams | sockets |
//! | [`fly`] | the shell of a flight | controllers |
//! | [`foreign`] | CRPL on ArduCopter and PX4 | controllers |
//! | [`bridge`] | a MAVLink router: who hears what, counters | flying |
//! | [`session`] | a conversation with one vehicle, the shell of the next rows | protocols |
//! | [`retry`] | what is asked again until it is answered | messages, sockets, clocks |
//! | [`commands`], [`fleet`] | commands until answered; who is out there | sockets, clocks |
//! | [`params`], [`missions`] | parameters and missions of any vehicle, and their files | sockets, clocks |
//! | [`replay`] | a flight that is over, on the wire again | flying |
//! | [`outs`] | what `--out` means | sockets |
//! | [`lab`] | flights in process, figures | protocols |
//! | [`run`] | the folder that a flight leaves behind | flying |
//! | [`episodes`] | many seeds in process | protocols |
//! | [`sweep`] | a scenario's key against the metrics; shares, resumption, tables | protocols |
//! | [`report`] | the paper's figures as a page | flying over a link |
//! | [`stats`] | means, intervals, paired bootstrap | controllers |
//! | [`parquet`] | flat tables in Parquet | what is in them |
//! | [`demo`] | both controllers against a `sitl` of its own | controllers' insides |

pub mod belief;
pub mod bridge;
pub mod commands;
pub mod demo;
pub mod episodes;
pub mod fleet;
pub mod fly;
pub mod foreign;
pub mod lab;
pub mod missions;
pub mod outs;
pub mod params;
pub mod parquet;
pub mod pilot;
pub mod remote;
pub mod replay;
pub mod report;
pub mod retry;
pub mod run;
pub mod session;
pub mod station;
pub mod stats;
pub mod sweep;
