//! The world model and its policies.
fn main() {}
