//! Tests of the crate against oracles, closed forms and published values.

mod behaviour;
mod card;
mod fields;
mod hardware;
mod oracle;
mod problems;
mod starts;
mod tiles;
mod unlit;
mod updates;
