//! Geomorphs of levels that a skeleton moves.

use glam::{DMat4, Vec3, Vec4};

use super::correspondence::{Correspondence, Target};
use super::geomorph::{GeomorphError, Level};
use super::texture::position;
use crate::Mesh;
use crate::mesh::{Attribute, MorphTarget, Semantic};

/// The rows of an affine transformation: a point p goes to the products of each row with (p, 1).
///
/// For a joint: from the model at rest to where the joint takes it, the joint's world matrix times its inverse bind
/// matrix; see [`joint_matrix`].
pub type JointMatrix = [[f32; 4]; 3];

/// A matrix as shaders and [`SkinnedGeomorph`] take it; the last row must be 0 0 0 1 and is dropped.
pub fn joint_matrix(matrix: &DMat4) -> JointMatrix {
    [0, 1, 2].map(|i| matrix.row(i).as_vec4().to_array())
}

/// Why wedges cannot be skinned.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkinError {
    /// No geomorph can be made.
    #[error(transparent)]
    Geomorph(#[from] GeomorphError),
    /// A level has no joints and weights.
    #[error("the {level} level has no joints and weights (4 of each to each wedge and set)")]
    NoSkin {
        /// Which level.
        level: Level,
    },
    /// A pose has fewer matrices than the levels have joints.
    #[error("{found} joint matrices, but the levels refer to {expected} joints")]
    TooFewMatrices {
        /// Matrices given.
        found: usize,
        /// Matrices needed.
        expected: usize,
    },
}

/// Wedges as a skeleton holds them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Posed {
    /// Their positions, in model units.
    pub positions: Vec<[f32; 3]>,
    /// Their unit normals; none if a level has none.
    pub normals: Vec<[f32; 3]>,
    /// Their unit tangents, and the sign of the bitangents; none if a level has none.
    pub tangents: Vec<[f32; 4]>,
}

/// The way from a finer level of a skinned model to a coarser one, in any pose.
///
/// Both levels are skinned, and the skinned wedges go straight from the one to the other (Houle 2000, 5.5): the ends
/// are exactly the two levels in that pose, whatever happens to joints and weights between them. Of the coarser level
/// only what moving wedges go to is skinned. Linear blend skinning with all sets of joints and weights that the levels
/// have, after blend shapes ([`pose_blended`](Self::pose_blended)); normals and tangents are turned by the same matrices and
/// brought back to length 1, which is exact for joints without unequal scales. The sign of a bitangent is that of the nearer
/// end.
///
/// What vanishes shrinks to its point, moved by the joints of each wedge that shrinks to it.
///
/// Attributes that a skeleton does not move: [`Geomorph`](super::Geomorph). Its joints and weights are not needed then.
///
/// # Examples
/// ```
/// use maille::lod::{Correspondence, Posed, SkinnedGeomorph};
/// use maille::mesh::{Attribute, Semantic, shapes};
/// # let skinned = |mut mesh: maille::Mesh| {
/// #     let wedges = mesh.wedge_count();
/// #     mesh.set_wedge_attribute(Attribute::new_u32(Semantic::Joints(0), 4, vec![0; 4 * wedges]));
/// #     mesh.set_wedge_attribute(Attribute::new_f32(Semantic::Weights(0), 4, [1.0, 0.0, 0.0, 0.0].repeat(wedges)));
/// #     mesh
/// # };
/// let (finer, coarser) = (skinned(shapes::sphere(3)), skinned(shapes::sphere(1)));
/// let correspondence = Correspondence::closest(&finer, &coarser)?;
/// let geomorph = SkinnedGeomorph::new(&finer, &coarser, &correspondence)?;
///
/// // one joint, moved by 1 along x
/// let pose = [[[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]];
/// let (mut shown, mut targets) = (Posed::default(), Posed::default());
/// geomorph.pose(&pose, &mut shown, &mut targets)?;
/// geomorph.morph(1.0, &mut shown, &targets);
/// let target = coarser.positions[correspondence.wedges[100] as usize];
/// assert_eq!(shown.positions[100], [target[0] + 1.0, target[1], target[2]]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct SkinnedGeomorph {
    finer: Skin,
    /// The wedges of the coarser level, then one for each wedge that vanishes.
    targets: Skin,
    /// Wedges of the finer level that move in some pose, and their places in `targets`.
    moving: Vec<[u32; 2]>,
    joints: usize,
}

impl SkinnedGeomorph {
    /// Prepares the way from one level to another.
    ///
    /// # Errors
    /// [`SkinError`] if a mesh or the correspondence is not valid, or a level has no joints and weights. An empty
    /// coarser level needs none.
    pub fn new(finer: &Mesh, coarser: &Mesh, correspondence: &Correspondence) -> Result<Self, SkinError> {
        for (level, mesh) in [(Level::Finer, finer), (Level::Coarser, coarser)] {
            mesh.check().map_err(|error| GeomorphError::Mesh { level, error })?;
        }
        correspondence.check(finer, coarser).map_err(GeomorphError::from)?;
        let influences = influences(finer).max(influences(coarser));
        let no_skin = |level| SkinError::NoSkin { level };
        let with_normals = [finer, coarser].iter().all(|mesh| normals(mesh).is_some() || mesh.wedge_count() == 0);
        let with_tangents = [finer, coarser].iter().all(|mesh| tangents(mesh).is_some() || mesh.wedge_count() == 0);
        let with = Fields { influences, normals: with_normals, tangents: with_tangents };
        let mut own = Skin::new(finer, with).ok_or(no_skin(Level::Finer))?;
        let mut targets = Skin::new(coarser, with).ok_or(no_skin(Level::Coarser))?;
        let shapes = own.shapes.len().max(targets.shapes.len());
        [&mut own, &mut targets].into_iter().for_each(|skin| skin.shapes.resize_with(shapes, Shape::default));
        let mut moving = Vec::new();
        let mut is_target = vec![false; coarser.wedge_count()];
        for wedge in 0..finer.wedge_count() as u32 {
            let place = match correspondence.target(wedge) {
                Target::Wedge(target) => target,
                Target::Point(point) => targets.push(point, &own, wedge),
            };
            if own.differs(wedge, &targets, place) {
                moving.push([wedge, place]);
                if let Some(is_target) = is_target.get_mut(place as usize) {
                    *is_target = true;
                }
            }
        }
        own.wanted = (0..finer.wedge_count() as u32).collect();
        let vanishing = coarser.wedge_count() as u32..targets.positions.len() as u32;
        targets.wanted =
            (0..coarser.wedge_count() as u32).filter(|&w| is_target[w as usize]).chain(vanishing).collect();
        let joints = own.joint_count().max(targets.joint_count());
        Ok(Self { finer: own, targets, moving, joints })
    }

    /// Skins the wedges of the finer level and what they go to.
    ///
    /// The one is given an element for each wedge of the finer level; the other one for each wedge of the coarser
    /// level (of which only those that something moves to are written) and, behind these, one for each wedge that
    /// vanishes, in ascending order.
    ///
    /// # Errors
    /// [`SkinError::TooFewMatrices`]; nothing is written then.
    pub fn pose(&self, matrices: &[JointMatrix], finer: &mut Posed, targets: &mut Posed) -> Result<(), SkinError> {
        self.pose_blended(matrices, &[], finer, targets)
    }

    /// As [`pose`](Self::pose), with the blend shapes of both levels on, each as far as `weights` says; those without a weight are
    /// off. A level that was given a `geomorph` shape for other viewers has it among these: it stays off here.
    ///
    /// # Errors
    /// [`SkinError::TooFewMatrices`]; nothing is written then.
    pub fn pose_blended(
        &self,
        matrices: &[JointMatrix],
        weights: &[f32],
        finer: &mut Posed,
        targets: &mut Posed,
    ) -> Result<(), SkinError> {
        let columns = self.columns(matrices)?;
        self.finer.pose(&columns, weights, finer);
        self.targets.pose(&columns, weights, targets);
        Ok(())
    }

    /// Moves the wedges of the posed finer level, in place: at `t` = 0 nothing happens, at 1 each becomes its target,
    /// to the bit. `t` is cut to 0 to 1; NaN counts as 0. Normals take the normalised line.
    ///
    /// Both come from [`pose`](Self::pose), or from anything else that skins and orders them in the same way.
    ///
    /// # Panics
    /// If there are fewer positions or normals than `pose` gives.
    pub fn morph(&self, t: f32, finer: &mut Posed, targets: &Posed) {
        if t.is_nan() || t <= 0.0 {
            return;
        }
        let t = t.min(1.0);
        let line = |from: [f32; 3], to: [f32; 3]| Vec3::from(from) * (1.0 - t) + Vec3::from(to) * t;
        self.move_each(
            &mut finer.positions,
            &targets.positions,
            |from, to| {
                if t < 1.0 { line(from, to).into() } else { to }
            },
        );
        let direction = |from: [f32; 3], to: [f32; 3]| {
            let nearer = if t < 0.5 { from } else { to };
            if t < 1.0 { line(from, to).try_normalize().map_or(nearer, Vec3::into) } else { to }
        };
        if !self.finer.normals.is_empty() {
            self.move_each(&mut finer.normals, &targets.normals, direction);
        }
        if !self.finer.tangents.is_empty() {
            self.move_each(&mut finer.tangents, &targets.tangents, |[ax, ay, az, a], [bx, by, bz, b]| {
                let [x, y, z] = direction([ax, ay, az], [bx, by, bz]);
                [x, y, z, if t < 0.5 { a } else { b }]
            });
        }
    }

    #[inline]
    fn move_each<const N: usize>(
        &self,
        out: &mut [[f32; N]],
        to: &[[f32; N]],
        between: impl Fn([f32; N], [f32; N]) -> [f32; N],
    ) {
        for &[wedge, target] in &self.moving {
            let out = &mut out[wedge as usize];
            *out = between(*out, to[target as usize]);
        }
    }

    /// How many values a moment takes to interpolate: positions, normals and tangents.
    pub fn interpolations(&self) -> usize {
        let fields = [self.finer.normals.is_empty(), self.finer.tangents.is_empty()];
        self.moving.len() * (1 + fields.iter().filter(|&&is_empty| !is_empty).count())
    }

    /// The largest distance, in model units and over the poses given, between where a wedge ends when only its
    /// position at rest is morphed and its own joints and weights move it (as a blend shape of glTF does:
    /// [`Geomorph::deltas`]), and where the coarser level really is.
    ///
    /// [`Geomorph::deltas`]: super::Geomorph::deltas
    ///
    /// # Errors
    /// [`SkinError::TooFewMatrices`] for any of the poses.
    pub fn residual<'p>(&self, poses: impl IntoIterator<Item = &'p [JointMatrix]>) -> Result<f32, SkinError> {
        let mut largest = 0.0;
        for pose in poses {
            let columns = self.columns(pose)?;
            for &[wedge, target] in &self.moving {
                let at_rest = self.targets.positions[target as usize];
                let moved = self.finer.blended(wedge, &columns).point(at_rest);
                let wanted = self.targets.blended(target, &columns).point(at_rest);
                largest = f32::max(largest, moved.distance(wanted));
            }
        }
        Ok(largest)
    }

    fn columns(&self, matrices: &[JointMatrix]) -> Result<Vec<Columns>, SkinError> {
        if matrices.len() < self.joints {
            return Err(SkinError::TooFewMatrices { found: matrices.len(), expected: self.joints });
        }
        Ok(matrices.iter().map(Columns::of).collect())
    }
}

/// The columns of a joint matrix, each in one register: blending and transforming are then sums of whole registers.
#[derive(Debug, Clone, Copy)]
struct Columns([Vec4; 4]);

impl Columns {
    fn of([x, y, z]: &JointMatrix) -> Self {
        Self([0, 1, 2, 3].map(|i| Vec4::new(x[i], y[i], z[i], 0.0)))
    }

    #[inline]
    fn vector(&self, v: [f32; 3]) -> Vec3 {
        (self.0[0] * v[0] + self.0[1] * v[1] + self.0[2] * v[2]).truncate()
    }

    #[inline]
    fn point(&self, p: [f32; 3]) -> Vec3 {
        (self.0[0] * p[0] + self.0[1] * p[1] + self.0[2] * p[2] + self.0[3]).truncate()
    }
}

/// Wedges at rest and what moves them.
#[derive(Debug, Clone, Default)]
struct Skin {
    positions: Vec<[f32; 3]>,
    /// Empty if they are not asked for.
    normals: Vec<[f32; 3]>,
    /// Empty if they are not asked for.
    tangents: Vec<[f32; 4]>,
    /// The blend shapes.
    shapes: Vec<Shape>,
    /// How many joints move each wedge: the same for all, so that the loop is the same.
    influences: usize,
    /// Each with its weight; those without weight are joint 0.
    joints: Vec<(u32, f32)>,
    /// Which are to be posed.
    wanted: Vec<u32>,
}

/// What a blend shape adds to wedges at rest; nothing, where a list is too short.
#[derive(Debug, Clone, Default)]
struct Shape {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    tangents: Vec<[f32; 3]>,
}

impl Shape {
    fn of(target: &MorphTarget) -> Self {
        let deltas = |semantic: Semantic| {
            let found = target.attributes.iter().find(|a| a.semantic == semantic && a.components == 3);
            found.and_then(Attribute::as_f32).map_or(Vec::new(), |values| values.as_chunks::<3>().0.to_vec())
        };
        Self {
            positions: deltas(Semantic::Position),
            normals: deltas(Semantic::Normal),
            tangents: deltas(Semantic::Tangent),
        }
    }

    fn lists(&self) -> [&[[f32; 3]]; 3] {
        [&self.positions, &self.normals, &self.tangents]
    }

    /// Adds the deltas of a wedge of another shape at the end, behind `count` others.
    fn push(&mut self, count: usize, like: &Self, wedge: u32) {
        let own = [&mut self.positions, &mut self.normals, &mut self.tangents];
        for (own, theirs) in own.into_iter().zip(like.lists()) {
            if let Some(&delta) = theirs.get(wedge as usize) {
                own.resize(count, [0.0; 3]);
                own.push(delta);
            }
        }
    }
}

/// What wedges have.
#[derive(Debug, Clone, Copy)]
struct Fields {
    influences: usize,
    normals: bool,
    tangents: bool,
}

impl Skin {
    /// `None` if the mesh has wedges, but no joints and weights.
    fn new(mesh: &Mesh, with: Fields) -> Option<Self> {
        let influences = with.influences;
        let wedges = mesh.wedge_count();
        if influences == 0 || (influences_of(mesh).next().is_none() && wedges > 0) {
            return None;
        }
        let mut joints = vec![(0, 0.0); wedges * influences];
        for (set, (set_joints, set_weights)) in influences_of(mesh).enumerate() {
            let pairs = set_joints.as_chunks::<4>().0.iter().zip(set_weights.as_chunks::<4>().0);
            for (wedge, (names, weights)) in joints.chunks_exact_mut(influences).zip(pairs) {
                for (place, (&name, &weight)) in wedge[4 * set..].iter_mut().zip(names.iter().zip(weights)) {
                    *place = if weight == 0.0 { (0, 0.0) } else { (name, weight) };
                }
            }
        }
        let positions = (0..wedges as u32).map(|wedge| position(mesh, wedge).to_array()).collect();
        let normals = normals(mesh).filter(|_| with.normals).map_or(Vec::new(), <[_]>::to_vec);
        let tangents = tangents(mesh).filter(|_| with.tangents).map_or(Vec::new(), <[_]>::to_vec);
        let shapes = mesh.morph_targets.iter().map(Shape::of).collect();
        Some(Self { positions, normals, tangents, shapes, influences, joints, wanted: Vec::new() })
    }

    /// Adds a point that moves as a wedge of another skin does, and tells its place.
    fn push(&mut self, point: [f32; 3], like: &Self, wedge: u32) -> u32 {
        let count = self.positions.len();
        self.positions.push(point);
        self.normals.extend(like.normals.get(wedge as usize));
        self.tangents.extend(like.tangents.get(wedge as usize));
        self.shapes.iter_mut().zip(&like.shapes).for_each(|(own, like)| own.push(count, like, wedge));
        self.joints.extend_from_slice(like.joints_of(wedge));
        self.positions.len() as u32 - 1
    }

    #[inline]
    fn joints_of(&self, wedge: u32) -> &[(u32, f32)] {
        &self.joints[wedge as usize * self.influences..][..self.influences]
    }

    /// Whether a wedge may be elsewhere, in some pose, than one of another skin.
    fn differs(&self, wedge: u32, other: &Self, place: u32) -> bool {
        fn bits<const N: usize>(values: &[[f32; N]], i: u32) -> Option<[u32; N]> {
            values.get(i as usize).map(|v| v.map(f32::to_bits))
        }
        let delta = |values: &[[f32; 3]], i: u32| values.get(i as usize).copied().unwrap_or_default();
        let mut shapes = self.shapes.iter().zip(&other.shapes);
        let joints = |skin: &Self, i: u32| -> Vec<(u32, u32)> {
            skin.joints_of(i).iter().map(|&(joint, weight)| (joint, weight.to_bits())).collect()
        };
        bits(&self.positions, wedge) != bits(&other.positions, place)
            || bits(&self.normals, wedge) != bits(&other.normals, place)
            || bits(&self.tangents, wedge) != bits(&other.tangents, place)
            || joints(self, wedge) != joints(other, place)
            || shapes.any(|(own, theirs)| {
                own.lists().into_iter().zip(theirs.lists()).any(|(a, b)| delta(a, wedge) != delta(b, place))
            })
    }

    fn joint_count(&self) -> usize {
        self.joints.iter().map(|&(joint, _)| joint as usize + 1).max().unwrap_or(0)
    }

    #[inline]
    fn blended(&self, wedge: u32, matrices: &[Columns]) -> Columns {
        let mut sum = [Vec4::ZERO; 4];
        for &(joint, weight) in self.joints_of(wedge) {
            let columns = &matrices[joint as usize].0;
            sum = [0, 1, 2, 3].map(|i| sum[i] + columns[i] * weight);
        }
        Columns(sum)
    }

    fn pose(&self, matrices: &[Columns], weights: &[f32], out: &mut Posed) {
        out.positions.resize(self.positions.len(), [0.0; 3]);
        out.normals.resize(self.normals.len(), [0.0; 3]);
        out.tangents.resize(self.tangents.len(), [0.0; 4]);
        let on = self.shapes.iter().zip(weights).filter(|&(_, &weight)| weight != 0.0);
        let on: Vec<(&Shape, f32)> = on.map(|(shape, &weight)| (shape, weight)).collect();
        let shaped = |value: [f32; 3], deltas: fn(&Shape) -> &[[f32; 3]], i: usize| -> [f32; 3] {
            let delta = |&(shape, weight): &(&Shape, f32)| Some(Vec3::from(*deltas(shape).get(i)?) * weight);
            on.iter().filter_map(delta).fold(Vec3::from(value), |sum, delta| sum + delta).into()
        };
        for &wedge in &self.wanted {
            let (blended, i) = (self.blended(wedge, matrices), wedge as usize);
            out.positions[i] = blended.point(shaped(self.positions[i], |shape| &shape.positions, i)).into();
            if let Some(&normal) = self.normals.get(i) {
                let turned = blended.vector(shaped(normal, |shape| &shape.normals, i));
                out.normals[i] = turned.try_normalize().map_or(normal, Vec3::into);
            }
            if let Some(&[x, y, z, sign]) = self.tangents.get(i) {
                let turned = blended.vector(shaped([x, y, z], |shape| &shape.tangents, i));
                let [x, y, z] = turned.try_normalize().map_or([x, y, z], Vec3::into);
                out.tangents[i] = [x, y, z, sign];
            }
        }
    }
}

/// Sets of joints and weights, four of each to a wedge, as far as they are without gap.
fn influences_of(mesh: &Mesh) -> impl Iterator<Item = (&[u32], &[f32])> {
    let set = |n| {
        let of = |semantic| mesh.wedge_attribute(&semantic).filter(|attribute: &&Attribute| attribute.components == 4);
        Some((of(Semantic::Joints(n))?.as_u32()?, of(Semantic::Weights(n))?.as_f32()?))
    };
    (0..).map_while(set)
}

fn influences(mesh: &Mesh) -> usize {
    4 * influences_of(mesh).count()
}

fn normals(mesh: &Mesh) -> Option<&[[f32; 3]]> {
    let normals = mesh.wedge_attribute(&Semantic::Normal).filter(|attribute| attribute.components == 3)?;
    Some(normals.as_f32()?.as_chunks::<3>().0)
}

fn tangents(mesh: &Mesh) -> Option<&[[f32; 4]]> {
    let tangents = mesh.wedge_attribute(&Semantic::Tangent).filter(|attribute| attribute.components == 4)?;
    Some(tangents.as_f32()?.as_chunks::<4>().0)
}
