//! The pearl in JavaScript and GLSL, over prepared arrays: for the simulator's page and for other people's.

/// Modules by name, none of which needs another at run time.
pub const MODULES: [(&str, &str); 5] = [
    ("npz.js", include_str!("../web/npz.js")),
    ("table.js", include_str!("../web/table.js")),
    ("look.js", include_str!("../web/look.js")),
    ("glsl/numerics.js", include_str!("../web/glsl/numerics.js")),
    ("glsl/pearl.js", include_str!("../web/glsl/pearl.js")),
];
