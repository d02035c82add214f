//! Automation: the same commands locally and in CI.

fn main() {}
