//! What a file holds: meshes, where they stand, and everything else, kept for writing it back.

use std::borrow::Cow;
use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use maille::skin::{Clip, Influences};
use maille::{Mesh, Semantic};

use crate::Animation;
use crate::gltf::Rig;

/// The content of a 3D file.
///
/// Each distinct mesh is there once, however often it is drawn, so that work on it is done once. What is not mesh
/// (materials, textures, nodes, skins, animations, comments, ...) stays in a private part and is written back as it
/// came when the output has the same format.
#[derive(Debug, Clone, Default)]
pub struct Asset {
    /// The distinct meshes. Reorder or remove none: the private part refers to them by index.
    pub meshes: Vec<NamedMesh>,
    /// Where the meshes are drawn; a mesh may appear several times or never.
    pub instances: Vec<Instance>,
    /// What was odd in the file but could be read, one sentence each, for the user.
    pub warnings: Vec<String>,
    /// How the nodes of a glTF move.
    pub(crate) clips: Arc<[Clip]>,
    /// What is not mesh.
    pub(crate) source: Source,
}

/// A mesh and its name.
#[derive(Debug, Clone, Default)]
pub struct NamedMesh {
    /// Name in the file, empty when there is none.
    pub name: String,
    /// The mesh.
    pub mesh: Mesh,
}

/// One appearance of a mesh, posed: those of an asset at rest, those of an [`Animation`] at a time. By default of the first
/// mesh, where it stands.
#[derive(Debug, Clone, Default)]
pub struct Instance {
    /// Index into [`Asset::meshes`].
    pub mesh: usize,
    /// From the mesh's space to the world's. Not used when there is a skin.
    pub transform: DMat4,
    /// With a skin: the matrix of each joint (world matrix times inverse bind matrix).
    pub joint_matrices: Option<Arc<[DMat4]>>,
    /// How far each morph target of the mesh is on; what is missing is off.
    pub morph_weights: Vec<f32>,
}

/// What is not mesh, by the format it came from.
#[derive(Debug, Clone, Default)]
pub(crate) enum Source {
    /// Made in code, or a format that holds nothing but meshes.
    #[default]
    None,
    /// A glTF, shared by the clones of an asset.
    Gltf(Arc<crate::gltf::Document>),
    /// PLY.
    Ply(Box<crate::ply::PlySource>),
    /// OBJ.
    Obj(Box<crate::obj::ObjSource>),
}

impl Asset {
    /// An asset of one mesh, drawn once where it stands.
    pub fn from_mesh(name: &str, mesh: Mesh) -> Self {
        Self {
            meshes: vec![NamedMesh { name: name.to_owned(), mesh }],
            instances: vec![Instance::default()],
            ..Self::default()
        }
    }

    /// Triangles of all distinct meshes.
    pub fn triangle_count(&self) -> usize {
        self.meshes.iter().map(|m| m.mesh.triangle_count()).sum()
    }

    /// How often each distinct mesh counts in what is drawn: once for each instance, and once if it has none.
    pub fn draws(&self) -> Vec<usize> {
        let mut draws = vec![0; self.meshes.len()];
        self.instances.iter().for_each(|instance| draws[instance.mesh] += 1);
        draws.iter().map(|&draws| draws.max(1)).collect()
    }

    /// Number of triangles, those of a mesh as often as it is drawn ([`draws`](Self::draws)).
    pub fn drawn_triangle_count(&self) -> usize {
        self.meshes.iter().zip(self.draws()).map(|(mesh, draws)| mesh.mesh.triangle_count() * draws).sum()
    }

    /// Everything that is drawn, as one mesh in world space with its attributes, posed at rest (morphs and skins
    /// applied). Free when that is one mesh where it stands.
    pub fn flattened(&self) -> Cow<'_, Mesh> {
        crate::flatten::flattened(self)
    }

    /// What else is in the file, with how many there are of it: `materials`, `textures`, `skins`, `animations` and
    /// whatever glTF has a list of. Empty for formats that hold nothing but meshes.
    pub fn contents(&self) -> Vec<(&'static str, usize)> {
        match &self.source {
            Source::Gltf(document) => document.contents(),
            _ => Vec::new(),
        }
    }

    /// The animations of a glTF, in its order; other formats have none.
    ///
    /// The joints of a clip's channels are the nodes of the file. What moves no node (materials, cameras) is not there, and
    /// neither are channels that are broken: [`warnings`](Self::warnings) tell of them. A clip without a name is called
    /// after its place: `clip 3` is the fourth.
    pub fn clips(&self) -> &[Clip] {
        &self.clips
    }

    /// Whether some of its nodes list levels of detail (`MSFT_lod`).
    pub fn has_levels(&self) -> bool {
        matches!(&self.source, Source::Gltf(document) if document.has_levels())
    }

    /// A clip, ready to tell where everything is at a time.
    ///
    /// # Panics
    /// If there is no such clip.
    ///
    /// # Examples
    /// ```
    /// let character = maille_io::sample(maille::samples::Sample::Character, 4000);
    /// let walk = character.animation(0);
    /// let step = character.merged_positions_of(&walk.instances_at(0.25 * character.clips()[0].end()));
    /// assert_eq!(step.triangle_count(), character.triangle_count());
    /// ```
    pub fn animation(&self, clip: usize) -> Animation {
        match &self.source {
            Source::Gltf(document) => Animation::new(document, self.clips[clip].clone()),
            _ => panic!("there is no clip {clip}"),
        }
    }

    /// Whether joints or morph targets deform any of its meshes.
    pub fn is_articulated(&self) -> bool {
        self.instances.iter().any(|instance| instance.joint_matrices.is_some())
            || self.meshes.iter().any(|named| !named.mesh.morph_targets.is_empty())
    }

    /// Its joints, to be turned at will; `None` for formats that have none.
    pub(crate) fn rig(&self) -> Option<Rig> {
        match &self.source {
            Source::Gltf(document) => Some(Rig::new(document)),
            _ => None,
        }
    }

    /// Everything that is drawn, as one mesh of positions in world space, posed at rest (morphs and skins applied).
    ///
    /// Meant for measuring: attributes are left out, vertices of different instances are not joined.
    pub fn merged_positions(&self) -> Mesh {
        self.merged_positions_of(&self.instances)
    }

    /// As [`merged_positions`](Self::merged_positions), for other instances of these meshes, such as those of an
    /// [`animation`](Self::animation).
    ///
    /// # Panics
    /// If an instance is of a mesh that is not there.
    pub fn merged_positions_of(&self, instances: &[Instance]) -> Mesh {
        let mut merged = Mesh::default();
        for instance in instances {
            let mesh = &self.meshes[instance.mesh].mesh;
            let points = instance.posed_wedges(mesh);
            let first = merged.positions.len() as u32;
            merged.positions.extend(points.iter().map(|p| p.as_vec3().to_array()));
            merged.triangles.extend(mesh.triangles.iter().map(|t| t.map(|w| first + w)));
        }
        merged.wedge_vertices = (0..merged.positions.len() as u32).collect();
        merged
    }
}

impl Instance {
    /// World position of each wedge of the mesh.
    fn posed_wedges(&self, mesh: &Mesh) -> Vec<DVec3> {
        (0..mesh.wedge_count()).map(|wedge| self.posed_wedge(mesh, wedge)).collect()
    }

    /// World position of a wedge of the mesh: morphed, then skinned or moved.
    ///
    /// # Panics
    /// If there is no such wedge.
    pub fn posed_wedge(&self, mesh: &Mesh, wedge: usize) -> DVec3 {
        let mut point = Vec3::from(mesh.positions[mesh.wedge_vertices[wedge] as usize]).as_dvec3();
        for (target, &weight) in
            mesh.morph_targets.iter().zip(&self.morph_weights).filter(|&(_, &weight)| weight != 0.0)
        {
            let deltas = target.attributes.iter().find(|a| a.semantic == Semantic::Position).and_then(|a| a.as_f32());
            if let Some(deltas) = deltas {
                point += Vec3::from_slice(&deltas[3 * wedge..]).as_dvec3() * f64::from(weight);
            }
        }
        self.wedge_matrix(mesh, wedge).transform_point3(point)
    }

    /// Whether the mesh is drawn as it is, only moved: no skin and no morph target deforms it.
    pub(crate) fn is_rigid(&self) -> bool {
        self.joint_matrices.is_none() && self.morph_weights.iter().all(|&weight| weight == 0.0)
    }

    /// From the mesh's space to the world's for one wedge: with a skin, the mean of its joints by weight.
    ///
    /// # Panics
    /// If there is no such wedge.
    pub fn wedge_matrix(&self, mesh: &Mesh, wedge: usize) -> DMat4 {
        let Some(matrices) = &self.joint_matrices else { return self.transform };
        Influences::of(mesh).blend(wedge as u32, matrices)
    }
}
