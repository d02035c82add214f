//! The `lut` tool.

fn main() {}
