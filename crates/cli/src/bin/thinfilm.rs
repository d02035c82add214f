//! The `thinfilm` tool.

fn main() {}
