//! A pearl table as a BSDF: eval, sample, pdf. Local shading frame, z = outward normal.
