//! The ways from one value to another, in arrays made to be streamed.
//!
//! What moves is gathered once, when a geomorph is prepared: the values at both ends lie side by side in the order in
//! which they are written. Then a moment of a geomorph reads two arrays and writes a third one, without looking
//! anything up. Houle (5.3.1) found looking the targets up as fast as stored vectors, in a time when computing was
//! dearer than memory.

use std::ops::Range;

use glam::{DVec3, Vec3, Vec4, Vec4Swizzles};

use crate::color;

/// Scalars to a block, the unit in which what moves is written: small enough for the first cache.
const BLOCK: usize = 1024;

/// A moment between the finer level (0) and the coarser one (1). The ends are exact: there, values are copied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moment {
    Finer,
    Between(f32),
    Coarser,
}

impl Moment {
    /// NaN counts as 0, what is outside as the nearer end.
    pub(super) fn new(t: f32) -> Self {
        if t >= 1.0 {
            Self::Coarser
        } else if t > 0.0 {
            Self::Between(t)
        } else {
            Self::Finer
        }
    }

    fn is_nearer_to_coarser(self) -> bool {
        match self {
            Self::Finer => false,
            Self::Between(t) => t >= 0.5,
            Self::Coarser => true,
        }
    }
}

/// Elements that move, and their values at both ends.
#[derive(Debug, Clone)]
pub(super) struct Ends<T> {
    /// Scalars per element.
    pub(super) components: usize,
    /// The wedges that move, ascending.
    pub(super) moving: Vec<u32>,
    /// Their values in the finer level.
    pub(super) from: Vec<T>,
    /// Their values in the coarser level.
    pub(super) to: Vec<T>,
}

impl<T: Copy + Default> Ends<T> {
    pub(super) fn new(components: usize) -> Self {
        Self { components, moving: Vec::new(), from: Vec::new(), to: Vec::new() }
    }

    pub(super) fn push(&mut self, wedge: u32, from: &[T], to: &[T]) {
        self.moving.push(wedge);
        self.from.extend_from_slice(from);
        self.to.extend_from_slice(to);
    }

    /// Each wedge that moves, with its values at both ends.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u32, &[T], &[T])> {
        let values = self.from.chunks_exact(self.components).zip(self.to.chunks_exact(self.components));
        self.moving.iter().zip(values).map(|(&wedge, (from, to))| (wedge, from, to))
    }

    /// Fills what moves into the array of all wedges: `fill` is asked for one range of moving elements after the other.
    fn write(&self, out: &mut [T], fill: impl Fn(Range<usize>, &mut [T])) {
        let n = self.components;
        let mut scratch = [T::default(); BLOCK];
        let per_block = (BLOCK / n).max(1);
        for (block, wedges) in self.moving.chunks(per_block).enumerate() {
            let range = block * per_block..block * per_block + wedges.len();
            let [first, last] = [wedges[0], wedges[wedges.len() - 1]].map(|wedge| wedge as usize);
            // all wedges between the two move, as is usual: no detour
            if last - first + 1 == wedges.len() {
                fill(range, &mut out[first * n..(last + 1) * n]);
                continue;
            }
            fill(range, &mut scratch[..wedges.len() * n]);
            match n {
                2 => scatter::<T, 2>(wedges, &scratch, out),
                3 => scatter::<T, 3>(wedges, &scratch, out),
                4 => scatter::<T, 4>(wedges, &scratch, out),
                _ => {
                    for (&wedge, value) in wedges.iter().zip(scratch.chunks_exact(n)) {
                        out[wedge as usize * n..][..n].copy_from_slice(value);
                    }
                }
            }
        }
    }

    /// Fills in the values of one end.
    fn write_end(&self, values: &[T], out: &mut [T]) {
        self.write(out, |range, out| out.copy_from_slice(&values[self.scalars(&range)]));
    }

    fn scalars(&self, range: &Range<usize>) -> Range<usize> {
        range.start * self.components..range.end * self.components
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.moving) + size_of_val(&*self.from) + size_of_val(&*self.to)
    }
}

/// Writes elements to their places; with the number of scalars known, a copy is a few moves.
fn scatter<T: Copy, const N: usize>(wedges: &[u32], values: &[T], out: &mut [T]) {
    let out = out.as_chunks_mut::<N>().0;
    for (&wedge, value) in wedges.iter().zip(values.as_chunks::<N>().0) {
        out[wedge as usize] = *value;
    }
}

/// The way that values take between their ends.
#[derive(Debug, Clone)]
pub(super) enum Way {
    /// A straight line.
    Straight,
    /// A jump in the middle.
    Switch,
    /// A jump at the very end.
    Hold,
    /// A straight line, brought back to length 1.
    Normalized(Directions),
    /// The great arc, at constant speed.
    Arc(Directions),
    /// A straight line in another space, and the way back from there.
    Color { from: Vec<f32>, to: Vec<f32>, back: fn([f32; 3]) -> [f32; 3] },
}

/// What directions need on their way, four floats for each moving element: the first three components and a number.
///
/// | way | `from` | `to` | `bend` |
/// |---|---|---|---|
/// | normalised line | unit vector | unit vector | squared distance of the two |
/// | arc | unit vector | unit vector across it, towards the end | angle between the ends, radians |
#[derive(Debug, Clone, Default)]
pub(super) struct Directions {
    /// Empty where the stored values are unit vectors already.
    from: Vec<f32>,
    to: Vec<f32>,
    bend: Vec<f32>,
}

/// How far from 1 a squared length may be for a vector to be taken as it is: some roundings of `f32`.
const UNIT_TOLERANCE: f64 = 1e-6;
/// Nearest squared distance from the centre, on the line between two unit vectors, for it to be walked: that of
/// vectors 170 degrees apart. On lines nearer to the centre nearly all of the turn comes in one moment, and rounding
/// shows.
const LEAST_LENGTH_SQ: f64 = 0.0076;

fn direction(value: &[f32]) -> DVec3 {
    Vec3::from_slice(value).as_dvec3()
}

/// Whether the normalised line from one direction to the other keeps away from the centre.
pub(super) fn has_line(from: &[f32], to: &[f32]) -> bool {
    let [a, b] = [from, to].map(|value| direction(value).try_normalize());
    a.zip(b).is_some_and(|(a, b)| (a + b).length_squared() > 4.0 * LEAST_LENGTH_SQ)
}

/// Whether there is an arc from one direction to the other.
pub(super) fn has_arc(from: &[f32], to: &[f32]) -> bool {
    [from, to].iter().all(|value| direction(value).try_normalize().is_some())
}

impl Directions {
    pub(super) fn lines(ends: &Ends<f32>) -> Self {
        let is_unit = |value: &[f32]| (direction(value).length_squared() - 1.0).abs() < UNIT_TOLERANCE;
        let is_kept = ends.components == 3 && ends.iter().all(|(_, from, to)| is_unit(from) && is_unit(to));
        let mut lines = Self::default();
        for (_, from, to) in ends.iter() {
            let [a, b] = [from, to].map(|value| direction(value).normalize());
            lines.bend.push(a.distance_squared(b) as f32);
            if !is_kept {
                lines.from.extend(a.as_vec3().to_array());
                lines.to.extend(b.as_vec3().to_array());
            }
        }
        lines
    }

    /// Lines that stay as long as they are: without a bend the factors are 1.
    pub(super) fn plain(ends: &Ends<f32>) -> Self {
        let vectors = |values: &[f32]| values.chunks_exact(ends.components).flat_map(|v| &v[..3]).copied().collect();
        Self { from: vectors(&ends.from), to: vectors(&ends.to), bend: vec![0.0; ends.moving.len()] }
    }

    pub(super) fn arcs(ends: &Ends<f32>) -> Self {
        let mut arcs = Self::default();
        for (_, from, to) in ends.iter() {
            let [a, b] = [from, to].map(|value| direction(value).normalize());
            // opposite directions: any way is as good as any other
            let across = (b - a * a.dot(b)).try_normalize().unwrap_or_else(|| a.any_orthonormal_vector());
            arcs.from.extend(a.as_vec3().to_array());
            arcs.to.extend(across.as_vec3().to_array());
            arcs.bend.push(a.cross(b).length().atan2(a.dot(b)) as f32);
        }
        arcs
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(&*self.from) + size_of_val(&*self.to) + size_of_val(&*self.bend)
    }
}

/// Elements of an attribute that move in the same way.
#[derive(Debug, Clone)]
pub(super) struct Path {
    pub(super) ends: Ends<f32>,
    pub(super) way: Way,
}

impl Path {
    /// Writes the values at a moment into the array of all wedges.
    pub(super) fn write(&self, moment: Moment, out: &mut [f32]) {
        let ends = &self.ends;
        let t = match moment {
            Moment::Finer => return ends.write_end(&ends.from, out),
            Moment::Coarser => return ends.write_end(&ends.to, out),
            Moment::Between(t) => t,
        };
        match &self.way {
            Way::Hold => ends.write_end(&ends.from, out),
            Way::Switch => write_nearer(ends, moment, out),
            Way::Straight => ends.write(out, |range, out| {
                let range = ends.scalars(&range);
                lerp(&ends.from[range.clone()], &ends.to[range], t, out);
            }),
            Way::Normalized(lines) => self.write_directions(lines, normalized, moment, t, out),
            Way::Arc(arcs) => self.write_directions(arcs, arc, moment, t, out),
            Way::Color { from, to, back } => ends.write(out, |range, out| {
                let range = ends.scalars(&range);
                lerp(&from[range.clone()], &to[range], t, out);
                for element in out.chunks_exact_mut(ends.components) {
                    let stored = back([element[0], element[1], element[2]]);
                    element[..3].copy_from_slice(&stored);
                }
            }),
        }
    }

    fn write_directions(&self, ways: &Directions, kernel: Kernel, moment: Moment, t: f32, out: &mut [f32]) {
        let ends = &self.ends;
        let (from, to) = if ways.from.is_empty() { (&ends.from, &ends.to) } else { (&ways.from, &ways.to) };
        let run = |range: Range<usize>, out: &mut [f32]| {
            let vectors = 3 * range.start..3 * range.end;
            kernel(&from[vectors.clone()], &to[vectors], &ways.bend[range], t, out);
        };
        if ends.components == 3 {
            return ends.write(out, run);
        }
        // tangents: what comes after the direction (the sign of the bitangent) is that of the nearer end
        let n = ends.components;
        let rest = if moment.is_nearer_to_coarser() { &ends.to } else { &ends.from };
        ends.write(out, |range, out| {
            let mut vectors = [0.0; BLOCK];
            let vectors = &mut vectors[..3 * range.len()];
            out.copy_from_slice(&rest[ends.scalars(&range)]);
            run(range, vectors);
            for (element, vector) in out.chunks_exact_mut(n).zip(vectors.as_chunks::<3>().0) {
                element[..3].copy_from_slice(vector);
            }
        });
    }

    pub(super) fn memory_bytes(&self) -> usize {
        let more = match &self.way {
            Way::Straight | Way::Switch | Way::Hold => 0,
            Way::Normalized(ways) | Way::Arc(ways) => ways.memory_bytes(),
            Way::Color { from, to, .. } => size_of_val(&**from) + size_of_val(&**to),
        };
        self.ends.memory_bytes() + more
    }
}

/// Writes the values of the nearer end; for what cannot be interpolated.
pub(super) fn write_nearer<T: Copy + Default>(ends: &Ends<T>, moment: Moment, out: &mut [T]) {
    ends.write_end(if moment.is_nearer_to_coarser() { &ends.to } else { &ends.from }, out);
}

/// From, to, bend, t: the directions at t.
type Kernel = fn(&[f32], &[f32], &[f32], f32, &mut [f32]);

/// Houle 5.2: a (1 - t) + b t.
#[inline]
pub(super) fn lerp(from: &[f32], to: &[f32], t: f32, out: &mut [f32]) {
    let s = 1.0 - t;
    for ((out, a), b) in out.iter_mut().zip(from).zip(to) {
        *out = a * s + b * t;
    }
}

/// Points of the line between unit vectors, brought back to length 1.
///
/// Their squared length is 1 - t (1 - t) |b - a|^2, and the last factor is known beforehand. So no sum over the
/// components of a vector is needed and the vectors can stay as they lie in memory, x y z x y z: four of them are
/// three registers, and one register of factors is spread over those by shuffles. Summing instead takes twice the time
/// (the compiler then gathers single floats). A series in place of root and division gains nothing.
fn normalized(from: &[f32], to: &[f32], bend: &[f32], t: f32, out: &mut [f32]) {
    let s = 1.0 - t;
    let (from, from_rest) = from.as_chunks::<12>();
    let (to, to_rest) = to.as_chunks::<12>();
    let (bend, bend_rest) = bend.as_chunks::<4>();
    let (out, out_rest) = out.as_chunks_mut::<12>();
    for (((out, a), b), bend) in out.iter_mut().zip(from).zip(to).zip(bend) {
        let length_sq = Vec4::ONE - Vec4::from_array(*bend) * (s * t);
        let factors = Vec4::ONE / Vec4::from_array(length_sq.to_array().map(f32::sqrt));
        for (i, factors) in [factors.xxxy(), factors.yyzz(), factors.zwww()].into_iter().enumerate() {
            let [a, b] = [a, b].map(|ends| Vec4::from_slice(&ends[4 * i..]));
            ((a * s + b * t) * factors).write_to_slice(&mut out[4 * i..]);
        }
    }
    let rest = from_rest.as_chunks::<3>().0.iter().zip(to_rest.as_chunks::<3>().0).zip(bend_rest);
    for (out, ((a, b), bend)) in out_rest.as_chunks_mut::<3>().0.iter_mut().zip(rest) {
        let factor = 1.0 / (1.0 - bend * (s * t)).sqrt();
        *out = [0, 1, 2].map(|i| (a[i] * s + b[i] * t) * factor);
    }
}

/// Points of the great arc from unit vectors along unit vectors across them.
fn arc(from: &[f32], across: &[f32], angle: &[f32], t: f32, out: &mut [f32]) {
    let ways = from.as_chunks::<3>().0.iter().zip(across.as_chunks::<3>().0).zip(angle);
    for (out, ((a, across), angle)) in out.as_chunks_mut::<3>().0.iter_mut().zip(ways) {
        let (sin, cos) = (angle * t).sin_cos();
        *out = [0, 1, 2].map(|i| a[i] * cos + across[i] * sin);
    }
}

/// The way of colours through a space: `into` leads there from linear light, `back` to what is stored.
pub(super) fn color_way(
    ends: &Ends<f32>,
    is_srgb: bool,
    into: fn([f32; 3]) -> [f32; 3],
    back: fn([f32; 3]) -> [f32; 3],
) -> Way {
    let there = |values: &[f32]| {
        let mut values = values.to_vec();
        for element in values.chunks_exact_mut(ends.components) {
            let stored = [element[0], element[1], element[2]];
            let light = if is_srgb { stored.map(color::to_linear) } else { stored };
            element[..3].copy_from_slice(&into(light));
        }
        values
    };
    Way::Color { from: there(&ends.from), to: there(&ends.to), back }
}
