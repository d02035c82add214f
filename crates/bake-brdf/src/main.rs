//! The `bake-brdf` tool.

fn main() {}
