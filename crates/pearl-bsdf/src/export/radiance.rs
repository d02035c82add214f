//! Radiance's BSDF file: XML with a tensor tree of rank 3, for isotropic surfaces.
//!
//! The tree halves the unit cube of (view, light): the view by p = (1 − sin θ)/2, of which the lower half is used, the light
//! by Shirley and Chiu's map of its projection on the disk to the square (a, b), turned so that the mirror direction has b = ½
//! and a > ½. The map keeps areas, so that the mean of f over the square times π is the albedo. Radiance reads a leaf without
//! interpolation and looks up by the viewing direction, so that a leaf holds the mean of f(light → view) over its cube:
//! [`PearlBsdf::eval_seen`] by the cosine of the light.
//!
//! Colour is Y, u' and v' in trees of the same leaves: linear sRGB, taken for the components of Radiance's colours. Radiance
//! sets what all leaves have in common apart as diffuse light, and loses the colours of a rank 3 tree when it does (found with
//! 6.1: `checkBSDF` then says `Color: 0`). One leaf without light keeps it from that: the smallest there is, at grazing.

use crate::{Direction, PearlBsdf};
use lut_io::FieldError;
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_4, PI};

/// Every cube is halved so often at least: no lobe but those at grazing fits between the points of such a cube.
const LEAST_LEVEL: u32 = 5;
/// And so often at most.
const LAST_LEVEL: u32 = 12;
/// Largest deviation of f from its mean in a leaf, times its volume, per radian of view.
const TOLERANCE: f64 = 3e-8;
/// Largest change of f with the view across a leaf, as a share, and where halving ends for its sake: a cube as thin as the view
/// near grazing would need is too small along the other axes.
const DRIFT: f64 = 0.03;
const LAST_FOR_DRIFT: u32 = 8;
/// Steps of the albedo over θ, degrees, and by how often leaves are moved towards it.
const ALBEDO_STEP_DEG: f64 = 0.25;
const ROUNDS: usize = 3;
/// Leaves of less area of the square than this are not moved: a few around the mirror direction would have to shine for all.
const LEAST_AREA: f64 = 2e-4;
/// Least that moving leaves of a leaf, as a share.
const LEAST_LEFT: f64 = 0.3;
/// By which Radiance keeps the normal in the half that is used.
const TINY: f64 = 1e-6;
/// Gauss's two points in a cell of unit length.
const POINTS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];
/// XYZ of Radiance's red, green and blue (its manual: (.640, .330), (.290, .600), (.150, .060), equal-energy white).
const XYZ_OF_RGB: [[f64; 3]; 3] = [
    [0.514_144_62, 0.265_105_82, 0.024_100_53],
    [0.323_884_48, 0.670_105_82, 0.122_852_73],
    [0.161_970_90, 0.064_788_36, 0.853_046_74],
];

/// A cube of the tree: its children by the halves of (view, a, b), bits 0 to 2 of their place, or the mean of f, RGB.
#[derive(Clone, Debug)]
enum Node {
    Branch(Box<[Self; 8]>),
    Leaf([f32; 3]),
}

/// How the value of a leaf is written in one of the trees.
type Written = fn(&[f32; 3]) -> String;

/// A tensor tree as Radiance reads it.
#[derive(Clone, Debug)]
pub(super) struct Tree(Node);

/// A cube: how often it is halved, and which one along each axis.
#[derive(Clone, Copy, Debug)]
struct Cube {
    level: u32,
    at: [u32; 3],
}

/// What f is within a cube.
struct Sampled {
    mean: [f32; 3],
    /// How far f is from its mean on average, times the volume, per radian of view.
    deviation: f64,
    /// By how much it changes with the view, as a share.
    drift: f64,
}

impl Tree {
    /// As fine as the lobes of this BSDF need.
    fn new(bsdf: &PearlBsdf) -> Self {
        let dark = || Node::Leaf([0.0; 3]);
        let root = Cube { level: 0, at: [0; 3] };
        let near = [root.child(0), root.child(2)];
        let [retro, forward] = near.map(|cube| node(bsdf, cube));
        // Beyond p = ½ there is no view; b and 1 − b are alike.
        let (retro_too, forward_too) = (retro.mirrored(), forward.mirrored());
        let mut root =
            Node::Branch(Box::new([retro, dark(), forward, dark(), retro_too, dark(), forward_too, dark()]));
        let albedo: Vec<[f64; 3]> = (0..=(90.0 / ALBEDO_STEP_DEG) as u32)
            .into_par_iter()
            .map(|step| {
                let theta = (f64::from(step) * ALBEDO_STEP_DEG).min(89.9).to_radians();
                let parts = bsdf.directional_albedo_seen(theta);
                std::array::from_fn(|c| parts.iter().map(|rgb| rgb[c]).sum())
            })
            .collect();
        for level in LEAST_LEVEL..=LAST_LEVEL {
            (0..ROUNDS).for_each(|_| keep_albedo(&mut root, level, &albedo));
        }
        root.darken(LAST_LEVEL);
        Self(root)
    }

    /// f·cos θ of the light, linear sRGB, as Radiance reads it.
    pub(super) fn eval(&self, view: Direction, light: Direction) -> [f64; 3] {
        let (sin, cos) = light_in_plane(view, light);
        let [a, b] = to_square(sin, cos);
        let mut at =
            [0.5 - TINY - 0.5 * view[0].hypot(view[1]), a, b].map(|x| x.clamp(0.0, 1.0 - f64::EPSILON));
        let mut node = &self.0;
        while let Node::Branch(children) = node {
            at = at.map(|x| 2.0 * x);
            let place: usize = (0..3).filter(|axis| at[*axis] >= 1.0).map(|axis| 1 << axis).sum();
            at = at.map(f64::fract);
            node = &children[place];
        }
        let Node::Leaf(rgb) = node else { return [0.0; 3] };
        rgb.map(|f| f64::from(f) * light[2])
    }

    /// The bytes of a BSDF file.
    fn encode(&self, name: &str) -> Vec<u8> {
        let name = super::xml_text(name);
        let mut text = format!(
            r#"<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="http://windows.lbl.gov/BSDF-v1.4.xsd">
<WindowElementType>System</WindowElementType>
<FileType>BSDF</FileType>
<Optical>
<Layer>
<Material>
<Name>{name}</Name>
<Manufacturer>nacre</Manufacturer>
<DeviceType>Other</DeviceType>
</Material>
<DataDefinition>
<IncidentDataStructure>TensorTree3</IncidentDataStructure>
</DataDefinition>
"#
        );
        let channels: [(&str, Written); 3] = [
            ("Visible", |rgb| format!("{:.4e}", yuv(*rgb)[0])),
            ("CIE-u", |rgb| format!("{:.4}", yuv(*rgb)[1])),
            ("CIE-v", |rgb| format!("{:.4}", yuv(*rgb)[2])),
        ];
        for (channel, of) in channels {
            text.push_str(&format!(
                r#"<WavelengthData>
<LayerNumber>System</LayerNumber>
<Wavelength unit="Integral">{channel}</Wavelength>
<SourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum>
<DetectorSpectrum>ASTM E308 1931 Y.dsp</DetectorSpectrum>
<WavelengthDataBlock>
<WavelengthDataDirection>Reflection Back</WavelengthDataDirection>
<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>
<ScatteringDataType>BRDF</ScatteringDataType>
<ScatteringData>
"#
            ));
            self.0.write(&mut text, of);
            text.push_str("\n</ScatteringData>\n</WavelengthDataBlock>\n</WavelengthData>\n");
        }
        text.push_str("</Layer>\n</Optical>\n</WindowElement>\n");
        text.into_bytes()
    }
}

/// The file of a BSDF, and the tree in it.
pub(super) fn encode(bsdf: &PearlBsdf, name: &str) -> Result<(Vec<u8>, Tree), FieldError> {
    super::check_xml(name)?;
    let tree = Tree::new(bsdf);
    Ok((tree.encode(name), tree))
}

fn node(bsdf: &PearlBsdf, cube: Cube) -> Node {
    if cube.level >= LEAST_LEVEL && !cube.hides_a_lobe(bsdf.slope_sd()) {
        let Sampled { mean, deviation, drift } = cube.sampled(bsdf);
        let even = deviation <= TOLERANCE && (drift <= DRIFT || cube.level >= LAST_FOR_DRIFT);
        if even || cube.level == LAST_LEVEL {
            return Node::Leaf(mean);
        }
    }
    let children: Vec<Node> = (0..8).into_par_iter().map(|place| node(bsdf, cube.child(place))).collect();
    children.try_into().map_or(Node::Leaf([0.0; 3]), |eight| Node::Branch(Box::new(eight)))
}

/// Moves leaves that are halved so often at least towards the albedo, in each slice of so thin views: cubes around a lobe are
/// smaller than elsewhere, and stand in for what thicker ones cannot follow. The same is added to all, which a peak does not feel.
fn keep_albedo(root: &mut Node, level: u32, albedo: &[[f64; 3]]) {
    let slices = 1usize << level;
    // Light over π, and the area of the leaves to be moved.
    let (mut light, mut area) = (vec![[0.0; 3]; slices], vec![0.0; slices]);
    root.visit(0, 0, &mut |leaf_level, at, rgb| {
        let deeper = leaf_level.saturating_sub(level);
        let size = 0.25f64.powi(leaf_level as i32) * 0.5f64.powi(deeper as i32);
        let thick = level.saturating_sub(leaf_level);
        let first = (at >> deeper) << thick;
        for slice in first..first + (1 << thick) {
            (0..3).for_each(|c| light[slice][c] += size * f64::from(rgb[c]));
            area[slice] += if leaf_level >= level { size } else { 0.0 };
        }
    });
    let missing: Vec<[f64; 3]> = (0..slices / 2)
        .map(|slice| {
            let at = POINTS.map(|x| read_albedo(albedo, (slice as f64 + x) / slices as f64));
            let wanted = |c: usize| 0.5 * (at[0][c] + at[1][c]) / PI;
            let share = |c: usize| {
                if area[slice] > LEAST_AREA { (wanted(c) - light[slice][c]) / area[slice] } else { 0.0 }
            };
            [0, 1, 2].map(share)
        })
        .collect();
    root.visit(0, 0, &mut |leaf_level, at, rgb| {
        if leaf_level < level {
            return;
        }
        if let Some(missing) = missing.get(at >> (leaf_level - level)) {
            for (value, more) in rgb.iter_mut().zip(missing) {
                *value = (f64::from(*value) + more).max(LEAST_LEFT * f64::from(*value)) as f32;
            }
        }
    });
}

/// The albedo at p.
fn read_albedo(albedo: &[[f64; 3]], p: f64) -> [f64; 3] {
    let position = (1.0 - 2.0 * p).asin().to_degrees() / ALBEDO_STEP_DEG;
    let below = (position as usize).min(albedo.len() - 2);
    let share = position - below as f64;
    std::array::from_fn(|c| albedo[below][c] + share * (albedo[below + 1][c] - albedo[below][c]))
}

impl Node {
    /// Hands out every leaf: how often it is halved, its place along p, its value.
    fn visit(&mut self, level: u32, at: usize, visitor: &mut impl FnMut(u32, usize, &mut [f32; 3])) {
        match self {
            Self::Leaf(rgb) => visitor(level, at, rgb),
            Self::Branch(children) => {
                for (place, child) in children.iter_mut().enumerate() {
                    child.visit(level + 1, 2 * at + (place & 1), visitor);
                }
            }
        }
    }

    /// With b and 1 − b exchanged.
    fn mirrored(&self) -> Self {
        match self {
            Self::Leaf(rgb) => Self::Leaf(*rgb),
            Self::Branch(children) => {
                Self::Branch(Box::new(std::array::from_fn(|place| children[place ^ 4].mirrored())))
            }
        }
    }

    /// Takes the light from the cube in the corner, so many levels down.
    fn darken(&mut self, levels: u32) {
        if levels == 0 {
            *self = Self::Leaf([0.0; 3]);
            return;
        }
        if let Self::Leaf(rgb) = *self {
            *self = Self::Branch(Box::new(std::array::from_fn(|_| Self::Leaf(rgb))));
        }
        if let Self::Branch(children) = self {
            children[0].darken(levels - 1);
        }
    }

    /// The tree in the format's braces; eight leaves as a grid, whose last axis runs fastest.
    fn write(&self, text: &mut String, of: Written) {
        text.push('{');
        match self {
            Self::Leaf(rgb) => text.push_str(&of(rgb)),
            Self::Branch(children) if children.iter().all(|child| matches!(child, Self::Leaf(_))) => {
                for place in [0, 4, 2, 6, 1, 5, 3, 7] {
                    if let Self::Leaf(rgb) = &children[place] {
                        text.push_str(&of(rgb));
                        text.push(' ');
                    }
                }
            }
            Self::Branch(children) => children.iter().for_each(|child| child.write(text, of)),
        }
        text.push_str("}\n");
    }
}

impl Cube {
    fn child(self, place: usize) -> Self {
        let half = |axis: usize| 2 * self.at[axis] + u32::from(place & (1 << axis) != 0);
        Self { level: self.level + 1, at: [half(0), half(1), half(2)] }
    }

    fn size(self) -> f64 {
        0.5f64.powi(self.level as i32)
    }

    /// Whether the mirror direction is within or next to a cube that is wider than a twentieth of the lobe of interface 0 there.
    fn hides_a_lobe(self, slope_sd: f64) -> bool {
        let size = self.size();
        let [p, a, b] = self.at.map(|at| f64::from(at) * size);
        let sin = 1.0 - 2.0 * p - size;
        // An exit angle has twice the standard deviation of the slopes, the square half the size of the disk.
        let sd = slope_sd * (1.0 - sin * sin).sqrt();
        // The mirror direction: b = 1/2, a = 1 - p.
        let near = |x: f64, widths: f64| x > -size && x < (widths + 1.0) * size;
        self.level < LAST_LEVEL && size > 0.05 * sd && near(0.5 - b, 1.0) && near(1.0 - p - a, 2.0)
    }

    /// What f is within.
    fn sampled(self, bsdf: &PearlBsdf) -> Sampled {
        let size = self.size();
        let along = |axis: usize| POINTS.map(|x| (f64::from(self.at[axis]) + x) * size);
        let [views, a, b] = [along(0), along(1), along(2)];
        let (mut values, mut inverse_cosines) = (Vec::with_capacity(8), 0.0);
        for p in views {
            let sin = 1.0 - 2.0 * p;
            let view = [-sin, 0.0, (1.0 - sin * sin).sqrt()];
            for light in a.iter().flat_map(|a| b.map(|b| from_square(*a, b))) {
                values.push(bsdf.eval_seen(view, light).rgb().map(|x| x / light[2]));
                inverse_cosines += 0.125 / light[2];
            }
        }
        // 1/cos θ is singular at the horizon, f·cos θ is not.
        let right = self.mean_inverse_cosine() / inverse_cosines;
        let mean: [f64; 3] = std::array::from_fn(|c| values.iter().map(|rgb| rgb[c] / 8.0).sum::<f64>());
        let apart = |rgb: &[f64; 3]| (0..3).map(|c| (rgb[c] - mean[c]).abs() / 24.0).sum::<f64>();
        let sin = 1.0 - (2.0 * f64::from(self.at[0]) + 1.0) * size;
        let deviation = values.iter().map(apart).sum::<f64>() * size.powi(3) / (1.0 - sin * sin).sqrt();
        let light = |values: &[[f64; 3]]| values.iter().flatten().sum::<f64>() / 24.0;
        let [near, far] = [&values[..4], &values[4..]].map(light);
        let drift = (near - far).abs() / (near + far + 0.02);
        Sampled { mean: mean.map(|x| (x * right) as f32), deviation, drift }
    }

    /// Mean of 1/cos θ of the light over a cell that does not cross the middle of the square.
    fn mean_inverse_cosine(self) -> f64 {
        // On a square of side 2, from its middle.
        let size = 2.0 * self.size();
        let from_middle = |axis: usize| {
            let start = f64::from(self.at[axis]) * size - 1.0;
            if start < 0.0 { -start - size } else { start }
        };
        let [a, b] = [from_middle(1), from_middle(2)];
        // The larger of the two coordinates is sin θ.
        let (start, end) = (a.max(b), (a.max(b) + size).min(1.0));
        let angle = end.asin() - start.asin();
        if (a - b).abs() > 0.5 * size {
            return angle / size;
        }
        let cosines = (1.0 - start * start).sqrt() - (1.0 - end * end).max(0.0).sqrt();
        2.0 * (cosines - start * angle) / (size * size)
    }
}

/// Direction of a point of the square.
fn from_square(a: f64, b: f64) -> Direction {
    let (a, b) = (2.0 * a - 1.0, 2.0 * b - 1.0);
    let (radius, angle) = if a.abs() > b.abs() {
        (a, FRAC_PI_4 * b / a)
    } else if b == 0.0 {
        (0.0, 0.0)
    } else {
        (b, FRAC_PI_4 * (2.0 - a / b))
    };
    let (sin, cos) = angle.sin_cos();
    [radius * cos, radius * sin, (1.0 - radius * radius).max(0.0).sqrt()]
}

/// Point of the square of a direction's projection on the disk.
fn to_square(x: f64, y: f64) -> [f64; 2] {
    let radius = x.hypot(y);
    let angle = y.atan2(x);
    // Eighths of a turn from the axis that is nearest.
    let quarter = (angle / (2.0 * FRAC_PI_4)).round();
    let across = radius * (angle - quarter * 2.0 * FRAC_PI_4) / FRAC_PI_4;
    let [a, b] = match quarter as i32 {
        0 => [radius, across],
        1 => [-across, radius],
        -1 => [across, -radius],
        _ => [-radius, -across],
    };
    [0.5 + 0.5 * a, 0.5 + 0.5 * b]
}

/// Projection of the light on the disk, turned so that the mirror direction of the view is along x.
fn light_in_plane(view: Direction, light: Direction) -> (f64, f64) {
    let sin = view[0].hypot(view[1]);
    let [x, y] = if sin > 0.0 { [-view[0] / sin, -view[1] / sin] } else { [1.0, 0.0] };
    (light[0] * x + light[1] * y, light[1] * x - light[0] * y)
}

/// CIE Y, u' and v' of a colour of Radiance; white for black.
fn yuv(rgb: [f32; 3]) -> [f64; 3] {
    let xyz = |i: usize| (0..3).map(|c| f64::from(rgb[c]) * XYZ_OF_RGB[c][i]).sum::<f64>();
    let [x, y, z] = [xyz(0), xyz(1), xyz(2)];
    let sum = x + 15.0 * y + 3.0 * z;
    if sum > 0.0 { [y, 4.0 * x / sum, 9.0 * y / sum] } else { [0.0, 4.0 / 19.0, 9.0 / 19.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_is_the_disk_and_back() {
        for i in 0..40 {
            for j in 0..40 {
                let [a, b] = [i, j].map(|i| (f64::from(i) + 0.37) / 40.0);
                let light = from_square(a, b);
                let back = to_square(light[0], light[1]);
                assert!((back[0] - a).abs() < 1e-12 && (back[1] - b).abs() < 1e-12, "{a} {b} {back:?}");
            }
        }
        // Region 1 of Shirley and Chiu: the first axis, up to the diagonal.
        assert_eq!(from_square(0.75, 0.5)[..2], [0.5, 0.0]);
    }

    #[test]
    fn mean_inverse_cosines_add_up_to_the_hemisphere() {
        let cells = |level: u32| {
            let count = 1 << level;
            let cubes = (0..count * count).map(move |i| Cube { level, at: [0, i % count, i / count] });
            cubes.map(|cube| cube.mean_inverse_cosine() * cube.size() * cube.size()).sum::<f64>()
        };
        // ∫ dA/cos θ over the disk is the solid angle 2π; the square stands for π.
        for level in [1, 3, 5] {
            assert!((PI * cells(level) - 2.0 * PI).abs() < 1e-9, "{level}: {}", cells(level));
        }
    }
}
