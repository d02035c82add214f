//! How large a table may be: nothing is allocated on the word of a file beyond this.

/// Most cells a table may have (incidences · φ cells · columns): 13 channels of it are 1.7 GB.
pub const MAX_CELLS: usize = 1 << 25;
/// Most cells along one axis, and most incidences.
pub const MAX_AXIS_CELLS: usize = 1 << 16;
/// Longest metadata text, bytes.
pub const MAX_META_BYTES: usize = 16 << 20;
