//! A finer level on its way to a coarser one.

use glam::Vec2;

use super::correspondence::{Correspondence, CorrespondenceError, Target};
use super::paths::{self, Directions, Ends, Moment, Path, Way};
use super::texture::{TextureSteps, position};
use crate::mesh::{Attribute, MeshError, MorphTarget, Semantic, Values};
use crate::{Mesh, color};

/// How normals and tangents go from one direction to the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NormalInterpolation {
    /// In a straight line: shorter than 1 in between, which shading may show as darkening. Costs as much as positions.
    Linear,
    /// In a straight line, and back to length 1: all that eyes can tell. Directions more than 170 degrees apart jump
    /// in the middle.
    #[default]
    NormalizedLinear,
    /// On the great arc, at constant speed. Costs several times as much.
    Spherical,
}

/// The space that colours go through in a straight line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColorInterpolation {
    /// Linear light; sRGB-encoded values are decoded for it.
    #[default]
    Rgb,
    /// CIE L*u*v*, in which equal steps look about equal.
    Luv,
}

/// How a [`Geomorph`] interpolates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GeomorphOptions {
    /// Normals and tangents.
    pub normals: NormalInterpolation,
    /// Colours; a fourth component always goes in a straight line.
    pub colors: ColorInterpolation,
}

/// One of two levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// The one with more detail.
    Finer,
    /// The one with less.
    Coarser,
}

impl std::fmt::Display for Level {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Finer => "finer",
            Self::Coarser => "coarser",
        })
    }
}

/// Why there is no [`Geomorph`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GeomorphError {
    /// A level is no valid mesh.
    #[error("{level} level: {error}")]
    Mesh {
        /// Which.
        level: Level,
        /// What is wrong.
        error: MeshError,
    },
    /// The correspondence does not fit the levels.
    #[error(transparent)]
    Correspondence(#[from] CorrespondenceError),
    /// The levels have the same attribute in different forms: number of components, floats or integers, linear or sRGB.
    #[error("attribute '{semantic}' has another form in the coarser level than in the finer one")]
    Form {
        /// Which attribute.
        semantic: Semantic,
    },
}

/// What a geomorph writes into: the positions and attributes of all wedges of the finer level.
#[derive(Debug, Clone, PartialEq)]
pub struct MorphedMesh {
    /// Position of each wedge, in model units.
    pub positions: Vec<[f32; 3]>,
    /// Attributes of each wedge: those of wedges, then those of vertices, in the order of the mesh.
    pub attributes: Vec<Attribute>,
}

impl MorphedMesh {
    /// The finer level as it is: the start of every [`Geomorph`].
    ///
    /// # Panics
    /// If [`Mesh::check`] fails.
    pub fn new(finer: &Mesh) -> Self {
        let positions = (0..finer.wedge_count() as u32).map(|wedge| position(finer, wedge).to_array()).collect();
        Self { positions, attributes: fields(finer).map(|field| field.to_attribute()).collect() }
    }

    /// The attribute of a meaning.
    pub fn attribute(&self, semantic: &Semantic) -> Option<&Attribute> {
        self.attributes.iter().find(|attribute| attribute.semantic == *semantic)
    }
}

/// The way from a finer level of detail to a coarser one, prepared to be shown at any moment.
///
/// At 0 it is the finer level; towards 1 every wedge moves to the one that it becomes in the coarser level, until its
/// triangles are those of the coarser level, and the others have no area: then the levels can be switched, and nothing
/// pops. Both ends are exact, bit for bit.
///
/// | | in between |
/// |---|---|
/// | positions | straight (Houle 2000, 5.2) |
/// | normals, tangents | [`NormalInterpolation`]; the sign of a bitangent is that of the nearer end |
/// | colours | [`ColorInterpolation`] |
/// | texture coordinates | straight; those that would sweep across the texture jump in the middle, or at the end if their triangles all vanish. These are steps more than twice as long, and one edge more, than the step in space explains by the density of the texture around |
/// | joints and weights, integers | those of the nearer end: at 0.5 the coarser level's |
/// | other attributes | straight |
///
/// Attributes that the coarser level lacks, and those of wedges that vanish, stay as they are. Blend shapes
/// ([`Mesh::morph_targets`]) and attributes of triangles take no part.
///
/// Only what differs in its bits between the levels is kept and moved, attribute by attribute.
///
/// Cost: linear, without search. Memory: for each wedge that moves 28 bytes (position) and 32 (normal); 56 if normals
/// were not unit vectors. Time: that of streaming this through, see the book's chapter on geomorphs for figures.
///
/// # Examples
/// ```
/// use maille::lod::{Correspondence, Geomorph, GeomorphOptions, MorphedMesh};
/// use maille::mesh::shapes;
/// let (finer, coarser) = (shapes::sphere(3), shapes::sphere(1));
/// let correspondence = Correspondence::closest(&finer, &coarser)?;
/// let geomorph = Geomorph::new(&finer, &coarser, &correspondence, &GeomorphOptions::default())?;
///
/// let mut shown = MorphedMesh::new(&finer);
/// geomorph.morph(0.5, &mut shown);
/// // every wedge is halfway between its position and that of its target
/// let target = coarser.positions[correspondence.wedges[100] as usize];
/// assert_eq!(shown.positions[100][0], 0.5 * finer.positions[100][0] + 0.5 * target[0]);
/// geomorph.morph(1.0, &mut shown);
/// assert_eq!(shown.positions[100], target);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Geomorph {
    wedges: usize,
    positions: Path,
    /// One for each attribute of a [`MorphedMesh`].
    channels: Vec<Channel>,
}

/// What moves in an attribute.
#[derive(Debug, Clone)]
struct Channel {
    semantic: Semantic,
    components: usize,
    moves: Moves,
}

#[derive(Debug, Clone)]
enum Moves {
    Floats(Vec<Path>),
    Integers(Ends<u32>),
}

impl Geomorph {
    /// Prepares the way from one level to another.
    ///
    /// The coarser level may be empty: then everything shrinks to the points of [`Correspondence::vanishing`].
    ///
    /// # Errors
    /// [`GeomorphError`] if a mesh is not valid, the correspondence does not fit, or an attribute has different forms.
    pub fn new(
        finer: &Mesh,
        coarser: &Mesh,
        correspondence: &Correspondence,
        options: &GeomorphOptions,
    ) -> Result<Self, GeomorphError> {
        for (level, mesh) in [(Level::Finer, finer), (Level::Coarser, coarser)] {
            mesh.check().map_err(|error| GeomorphError::Mesh { level, error })?;
        }
        correspondence.check(finer, coarser)?;
        let levels = [finer, coarser];
        let channel = |field: Field<'_>| {
            let moves = match fields(coarser).find(|other| other.semantic() == field.semantic()) {
                Some(other) if other.form() != field.form() => {
                    return Err(GeomorphError::Form { semantic: field.semantic().clone() });
                }
                other => field.moves(other, levels, correspondence, options),
            };
            Ok(Channel { semantic: field.semantic().clone(), components: field.components(), moves })
        };
        Ok(Self {
            wedges: finer.wedge_count(),
            positions: Path { ends: moving_positions(levels, correspondence), way: Way::Straight },
            channels: fields(finer).map(channel).collect::<Result<_, _>>()?,
        })
    }

    /// Number of wedges of the finer level.
    pub fn wedge_count(&self) -> usize {
        self.wedges
    }

    /// How many values a moment takes to interpolate: positions that move, and normals that do.
    pub fn interpolations(&self) -> usize {
        let normals = self.paths(&Semantic::Normal).iter().map(|path| path.ends.moving.len());
        self.positions.ends.moving.len() + normals.sum::<usize>()
    }

    /// Bytes that it takes.
    pub fn memory_bytes(&self) -> usize {
        let of_channel = |channel: &Channel| match &channel.moves {
            Moves::Floats(paths) => paths.iter().map(Path::memory_bytes).sum(),
            Moves::Integers(ends) => ends.memory_bytes(),
        };
        self.positions.memory_bytes() + self.channels.iter().map(of_channel).sum::<usize>()
    }

    /// Writes a moment, from 0 (the finer level) to 1 (what it becomes in the coarser one). `t` is cut to that; NaN
    /// counts as 0.
    ///
    /// Only what moves is written: `out` must come from [`MorphedMesh::new`] with the same finer level, and may have
    /// been written before.
    ///
    /// # Panics
    /// If `out` has other numbers of wedges or attributes.
    pub fn morph(&self, t: f32, out: &mut MorphedMesh) {
        let moment = Moment::new(t);
        self.morph_positions(t, &mut out.positions);
        assert_eq!(out.attributes.len(), self.channels.len(), "made from the same finer level");
        for (channel, attribute) in self.channels.iter().zip(&mut out.attributes) {
            assert_eq!(attribute.values.len(), self.wedges * channel.components, "made from the same finer level");
            match (&channel.moves, &mut attribute.values) {
                (Moves::Floats(paths), Values::F32(values)) => paths.iter().for_each(|p| p.write(moment, values)),
                (Moves::Integers(ends), Values::U32(values)) => paths::write_nearer(ends, moment, values),
                _ => panic!("made from the same finer level: '{}'", channel.semantic),
            }
        }
    }

    /// Writes the positions of a moment, as [`morph`](Self::morph) does: into a mapped buffer, say. Those of wedges
    /// that do not move must be there already.
    ///
    /// # Panics
    /// If `out` has another length than the finer level has wedges.
    pub fn morph_positions(&self, t: f32, out: &mut [[f32; 3]]) {
        assert_eq!(out.len(), self.wedges, "one position to each wedge of the finer level");
        self.positions.write(Moment::new(t), out.as_flattened_mut());
    }

    /// Writes the normals of a moment, as [`morph_positions`](Self::morph_positions) does; nothing if there are none.
    ///
    /// # Panics
    /// If `out` has another length than the finer level has wedges.
    pub fn morph_normals(&self, t: f32, out: &mut [[f32; 3]]) {
        assert_eq!(out.len(), self.wedges, "one normal to each wedge of the finer level");
        for path in self.paths(&Semantic::Normal).iter().filter(|path| path.ends.components == 3) {
            path.write(Moment::new(t), out.as_flattened_mut());
        }
    }

    /// What to add to the finer level's positions, normals, tangents, texture coordinates and colours to get to the coarser
    /// level: a blend shape for any viewer, to be given weights from 0 to 1. It is named `geomorph`.
    ///
    /// Exact up to the rounding of one addition. In between, normals are not brought back to length 1 (viewers do
    /// that), and all else goes straight: also texture coordinates that jump in [`morph`](Self::morph). Those of triangles
    /// that vanish stay. Attributes that the finer level lacks are left out, and so are texture coordinates and colours
    /// that nowhere change.
    pub fn deltas(&self) -> MorphTarget {
        let paths = std::slice::from_ref(&self.positions);
        let mut attributes = vec![self.delta(Semantic::Position, 3, paths)];
        for channel in &self.channels {
            let paths = self.paths(&channel.semantic);
            match channel.semantic {
                Semantic::Normal | Semantic::Tangent if channel.components >= 3 => {
                    attributes.push(self.delta(channel.semantic.clone(), 3, paths));
                }
                Semantic::TexCoord(_) | Semantic::Color(_) if paths.iter().any(|path| !path.ends.moving.is_empty()) => {
                    attributes.push(self.delta(channel.semantic.clone(), channel.components, paths));
                }
                _ => {}
            }
        }
        MorphTarget { name: "geomorph".into(), attributes }
    }

    /// What every wedge of the finer level becomes, as attributes beside its own: `_MORPH_POSITION`, `_MORPH_NORMAL`,
    /// `_MORPH_TANGENT`, `_MORPH_TEXCOORD_n`, `_MORPH_COLOR_n`, `_MORPH_JOINTS_n` and `_MORPH_WEIGHTS_n`; for engines
    /// that go from one to the other in a shader, exactly.
    ///
    /// `finer` is the level that the geomorph was made from. Wedges that stay, or vanish without becoming another, have
    /// their own values there.
    ///
    /// # Panics
    /// If `finer` has other numbers of wedges or attributes.
    pub fn targets(&self, finer: &Mesh) -> Vec<Attribute> {
        let mut end = MorphedMesh::new(finer);
        self.morph(1.0, &mut end);
        let position = Attribute::new_f32(Semantic::Position, 3, end.positions.into_flattened());
        let named = |attribute: Attribute| {
            if matches!(attribute.semantic, Semantic::Custom(_)) {
                return None;
            }
            let name = attribute.semantic.gltf_name();
            let semantic = Semantic::Custom(format!("_MORPH_{name}"));
            Some(Attribute { semantic, ..attribute })
        };
        std::iter::once(position).chain(end.attributes).filter_map(named).collect()
    }

    /// Paths of a float attribute; none if there is no such attribute.
    fn paths(&self, semantic: &Semantic) -> &[Path] {
        let moves = self.channels.iter().find(|channel| channel.semantic == *semantic).map(|channel| &channel.moves);
        match moves {
            Some(Moves::Floats(paths)) => paths,
            Some(Moves::Integers(_)) | None => &[],
        }
    }

    /// Differences of the first components, 0 where nothing moves or only at the very end.
    fn delta(&self, semantic: Semantic, components: usize, paths: &[Path]) -> Attribute {
        let mut deltas = vec![0.0; components * self.wedges];
        let seen = paths.iter().filter(|path| !matches!(path.way, Way::Hold));
        for (wedge, from, to) in seen.flat_map(|path| path.ends.iter()) {
            let own = &mut deltas[components * wedge as usize..][..components];
            own.iter_mut().zip(from.iter().zip(to)).for_each(|(delta, (from, to))| *delta = to - from);
        }
        Attribute::new_f32(semantic, components, deltas)
    }
}

/// Bits of floats, which tell what moves: a zero is not the other zero, and a NaN may stay.
fn differ(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).any(|(a, b)| a.to_bits() != b.to_bits())
}

fn moving_positions([finer, coarser]: [&Mesh; 2], correspondence: &Correspondence) -> Ends<f32> {
    let mut ends = Ends::new(3);
    for wedge in 0..finer.wedge_count() as u32 {
        let from = position(finer, wedge).to_array();
        let to = match correspondence.target(wedge) {
            Target::Wedge(target) => position(coarser, target).to_array(),
            Target::Point(point) => point,
        };
        if differ(&from, &to) {
            ends.push(wedge, &from, &to);
        }
    }
    ends
}

/// Attributes of wedges and vertices, looked up by wedge.
fn fields(mesh: &Mesh) -> impl Iterator<Item = Field<'_>> {
    let of_wedges = mesh.wedge_attributes.iter().map(|attribute| Field { attribute, vertices: None });
    let of_vertices = (mesh.vertex_attributes.iter())
        .filter(|attribute| mesh.wedge_attribute(&attribute.semantic).is_none())
        .map(|attribute| Field { attribute, vertices: Some(&mesh.wedge_vertices) });
    of_wedges.chain(of_vertices).filter(|field| field.components() > 0)
}

#[derive(Debug, Clone, Copy)]
struct Field<'m> {
    attribute: &'m Attribute,
    /// Vertex of each wedge, if there is one element to each vertex.
    vertices: Option<&'m [u32]>,
}

impl<'m> Field<'m> {
    fn semantic(self) -> &'m Semantic {
        &self.attribute.semantic
    }

    fn components(self) -> usize {
        self.attribute.components
    }

    /// What must be the same for values to be interpolated.
    fn form(self) -> (usize, bool, bool) {
        (self.components(), self.attribute.as_f32().is_some(), self.attribute.storage.srgb)
    }

    fn element<T>(self, values: &'m [T], wedge: u32) -> &'m [T] {
        let element = self.vertices.map_or(wedge, |vertices| vertices[wedge as usize]);
        &values[element as usize * self.components()..][..self.components()]
    }

    fn to_attribute(self) -> Attribute {
        let mut attribute = self.attribute.clone();
        if let Some(vertices) = self.vertices {
            attribute.gather(vertices);
        }
        attribute
    }

    /// What moves when the wedges go to those of the other level, and how.
    fn moves(
        self,
        other: Option<Self>,
        levels: [&Mesh; 2],
        correspondence: &Correspondence,
        options: &GeomorphOptions,
    ) -> Moves {
        let pairs = (0..correspondence.wedges.len() as u32).filter_map(|wedge| match correspondence.target(wedge) {
            Target::Wedge(target) => Some((wedge, target, other?)),
            Target::Point(_) => None,
        });
        match &self.attribute.values {
            Values::U32(values) => {
                let mut ends = Ends::new(self.components());
                for (wedge, target, other) in pairs {
                    let [from, to] = [self.element(values, wedge), other.element(other.integers(), target)];
                    if from != to {
                        ends.push(wedge, from, to);
                    }
                }
                Moves::Integers(ends)
            }
            Values::F32(values) => {
                let ends = |wedge, target, other: Self| {
                    (wedge, target, self.element(values, wedge), other.element(other.floats(), target))
                };
                let pairs = pairs.map(|(wedge, target, other)| ends(wedge, target, other));
                Moves::Floats(self.float_paths(pairs, other, levels, correspondence, options))
            }
        }
    }

    fn float_paths<'p>(
        self,
        pairs: impl Iterator<Item = (u32, u32, &'p [f32], &'p [f32])>,
        other: Option<Self>,
        levels: [&Mesh; 2],
        correspondence: &Correspondence,
        options: &GeomorphOptions,
    ) -> Vec<Path> {
        let n = self.components();
        let mut sorted = [Ends::new(n), Ends::new(n), Ends::new(n)];
        let steps = match (self.semantic(), other) {
            (Semantic::TexCoord(_), Some(other)) if n == 2 => {
                let uv = |field: Self| move |wedge| Vec2::from_slice(field.element(field.floats(), wedge));
                Some(TextureSteps::new(levels, correspondence, uv(self), uv(other)))
            }
            _ => None,
        };
        let is_direction = matches!(self.semantic(), Semantic::Normal | Semantic::Tangent) && n >= 3;
        for (wedge, target, from, to) in pairs.filter(|(.., from, to)| differ(from, to)) {
            let way = match (self.semantic(), &steps) {
                (Semantic::Weights(_), _) => Way::Switch,
                (_, Some(steps)) => {
                    let step = position(levels[0], wedge).distance(position(levels[1], target));
                    steps.way(wedge, target, step, Vec2::from_slice(from).distance(Vec2::from_slice(to)))
                }
                _ if !is_direction || options.normals.has_way(from, to) => Way::Straight,
                _ => Way::Switch,
            };
            let place = match way {
                Way::Switch => 1,
                Way::Hold => 2,
                _ => 0,
            };
            sorted[place].push(wedge, from, to);
        }
        let [smooth, switching, held] = sorted;
        let way = match self.semantic() {
            _ if is_direction => options.normals.way(&smooth),
            Semantic::Color(_) if n >= 3 => options.colors.way(&smooth, self.attribute.storage.srgb),
            _ => Way::Straight,
        };
        let paths = [(smooth, way), (switching, Way::Switch), (held, Way::Hold)];
        (paths.into_iter().map(|(ends, way)| Path { ends, way })).filter(|path| !path.ends.moving.is_empty()).collect()
    }

    fn floats(self) -> &'m [f32] {
        self.attribute.as_f32().expect("forms are the same")
    }

    fn integers(self) -> &'m [u32] {
        self.attribute.as_u32().expect("forms are the same")
    }
}

impl NormalInterpolation {
    /// Whether there is a way of this kind from one direction to the other.
    fn has_way(self, from: &[f32], to: &[f32]) -> bool {
        match self {
            Self::Linear => true,
            Self::NormalizedLinear => paths::has_line(from, to),
            Self::Spherical => paths::has_arc(from, to),
        }
    }

    fn way(self, ends: &Ends<f32>) -> Way {
        match self {
            Self::Linear if ends.components == 3 => Way::Straight,
            Self::Linear => Way::Normalized(Directions::plain(ends)),
            Self::NormalizedLinear => Way::Normalized(Directions::lines(ends)),
            Self::Spherical => Way::Arc(Directions::arcs(ends)),
        }
    }
}

impl ColorInterpolation {
    fn way(self, ends: &Ends<f32>, is_srgb: bool) -> Way {
        match (self, is_srgb) {
            (Self::Rgb, false) => Way::Straight,
            (Self::Rgb, true) => paths::color_way(ends, is_srgb, |light| light, |light| light.map(color::to_srgb)),
            (Self::Luv, false) => paths::color_way(ends, is_srgb, color::to_luv, color::from_luv),
            (Self::Luv, true) => {
                paths::color_way(ends, is_srgb, color::to_luv, |luv| color::from_luv(luv).map(color::to_srgb))
            }
        }
    }
}
