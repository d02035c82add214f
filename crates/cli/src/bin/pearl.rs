//! The `pearl` tool.

fn main() {}
