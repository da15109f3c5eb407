//! `maille info`

use std::borrow::Cow;

use glam::Vec3;
use maille::measure::{area, volume};
use maille::mesh::Values;
use maille::repair::{Diagnosis, diagnose};
use maille::{Attribute, Mesh};
use maille_io::{Asset, Format};
use serde_json::{Map, Value, json};

use super::progressive::ProgressiveFacts;
use crate::args::InfoArgs;
use crate::failure::Failure;
use crate::output::{self, Listing};
use crate::session::Session;

pub(crate) fn run(args: &InfoArgs) -> Result<(), Failure> {
    let session = Session::start(&args.common)?;
    let format = maille_io::detect(&args.file)?;
    let (asset, progressive) = match format {
        Format::Mpm => {
            let mut progressive = session.open_progressive(&args.file)?;
            (progressive.finest(), Some(ProgressiveFacts::of(&progressive)))
        }
        _ => (session.open(&args.file)?, None),
    };
    let drawn = asset.flattened();
    let facts = Facts {
        file: args.file.display().to_string(),
        bytes: std::fs::metadata(&args.file).map_or(0, |meta| meta.len()),
        format,
        progressive,
        meshes: asset.meshes.iter().map(|named| MeshFacts::of(&named.name, &named.mesh)).collect(),
        bounds: drawn.bounds(),
        area: area(&drawn),
        volume: volume(&drawn),
        // only then it costs nothing to bring all that is drawn together
        is_drawn_as_is: matches!(drawn, Cow::Borrowed(_)) && asset.meshes.len() == 1 && asset.instances.len() == 1,
        levels: match asset.split_levels() {
            Some(Ok((_, levels))) => levels.iter().map(|level| level.triangles).collect(),
            _ => Vec::new(),
        },
        asset: &asset,
    };
    session.checkpoint()?;
    session.result(|| facts.json(), || facts.text())
}

/// What there is to tell of a file.
struct Facts<'a> {
    file: String,
    bytes: u64,
    format: Format,
    progressive: Option<ProgressiveFacts>,
    asset: &'a Asset,
    meshes: Vec<MeshFacts<'a>>,
    /// Of all that is drawn, posed at rest, like the next two.
    bounds: Option<([f32; 3], [f32; 3])>,
    area: f64,
    volume: f64,
    /// Whether that is one mesh where it stands.
    is_drawn_as_is: bool,
    /// Triangles of each level of detail.
    levels: Vec<usize>,
}

/// What there is to tell of a mesh, in its own units.
struct MeshFacts<'a> {
    name: &'a str,
    mesh: &'a Mesh,
    area: f64,
    volume: f64,
    diagnosis: Diagnosis,
}

impl<'a> MeshFacts<'a> {
    fn of(name: &'a str, mesh: &'a Mesh) -> Self {
        Self { name, mesh, area: area(mesh), volume: volume(mesh), diagnosis: diagnose(mesh) }
    }

    /// Where an attribute lives, and the attribute.
    fn attributes(&self) -> impl Iterator<Item = (&'static str, &'a Attribute)> {
        let mesh = self.mesh;
        let wedges = mesh.wedge_attributes.iter().map(|a| ("wedge", a));
        let vertices = mesh.vertex_attributes.iter().map(|a| ("vertex", a));
        let triangles = mesh.triangle_attributes.iter().map(|a| ("triangle", a));
        wedges.chain(vertices).chain(triangles)
    }

    fn material_count(&self) -> usize {
        let used = self.mesh.triangle_materials.iter().max().map_or(0, |&slot| slot as usize + 1);
        used.max(self.mesh.material_names.len())
    }

    fn json(&self) -> Value {
        let mesh = self.mesh;
        json!({
            "name": self.name,
            "triangles": mesh.triangle_count(),
            "vertices": mesh.vertex_count(),
            "wedges": mesh.wedge_count(),
            "attributes": self.attributes().map(|(on, a)| attribute_json(on, a)).collect::<Vec<_>>(),
            "materials": self.material_count(),
            "material_names": mesh.material_names,
            "morph_targets": mesh.morph_targets.iter().map(|target| &target.name).collect::<Vec<_>>(),
            "bounds": bounds_json(mesh.bounds()),
            "area": self.area,
            "volume": self.volume,
            "edges": self.diagnosis.edges,
            "components": self.diagnosis.components,
            "boundary_edges": self.diagnosis.boundary_edges,
            "boundary_loops": self.diagnosis.boundary_loops,
            "euler_characteristic": self.diagnosis.euler_characteristic,
            "genus": self.diagnosis.genus,
            "closed": self.diagnosis.closed,
            "manifold": self.diagnosis.is_manifold(),
            "orientable": self.diagnosis.orientable,
            "zero_area_triangles": self.diagnosis.zero_area_triangles,
            "opposite_duplicates": self.diagnosis.opposite_duplicates,
            "zero_normals": self.diagnosis.zero_normals,
            "defects": self.diagnosis.defects().map(|defect| json!({
                "defect": defect.name,
                "count": defect.count,
                "repair": defect.remedy.map(|remedy| remedy.name()),
            })).collect::<Vec<_>>(),
        })
    }

    /// Area and volume are told only where they are not those of the whole file.
    fn describe(&self, listing: &mut Listing, index: usize, is_whole_file: bool) {
        let mesh = self.mesh;
        let name = if self.name.is_empty() { String::new() } else { format!(" '{}'", self.name) };
        listing.heading(format!("mesh {index}{name}"));
        let count = |n: usize| output::count(n);
        listing.line(
            "size",
            format!(
                "{} triangles, {} vertices, {} wedges",
                count(mesh.triangle_count()),
                count(mesh.vertex_count()),
                count(mesh.wedge_count())
            ),
        );
        for (on, attribute) in self.attributes() {
            listing.line(attribute.semantic.to_string(), format!("per {on}, {}", attribute_text(attribute)));
        }
        if self.material_count() > 0 {
            listing.line("materials", format!("{} {}", self.material_count(), names(&mesh.material_names)));
        }
        if !mesh.morph_targets.is_empty() {
            let targets: Vec<String> = mesh.morph_targets.iter().map(|target| target.name.clone()).collect();
            listing.line("morph targets", format!("{} {}", targets.len(), names(&targets)));
        }
        listing.line("surface", self.surface());
        if !is_whole_file {
            let volume =
                if self.diagnosis.closed { format!(", volume {}", output::number(self.volume)) } else { String::new() };
            listing.line("in its units", format!("area {}{volume}", output::number(self.area)));
        }
        for defect in self.diagnosis.defects() {
            let remedy = defect.remedy.map_or(String::new(), |remedy| format!(" (repair: {})", remedy.name()));
            listing.line("defect", format!("{} {}{remedy}", count(defect.count), defect.name));
        }
    }

    fn surface(&self) -> String {
        let d = &self.diagnosis;
        let mut parts = vec![match d.closed {
            true => "closed".to_owned(),
            false => format!("open, {}", plural(d.boundary_loops, "boundary loop")),
        }];
        parts.push(if d.is_manifold() { "manifold".to_owned() } else { "not manifold".to_owned() });
        parts.push(plural(d.components, "component"));
        match d.genus {
            Some(genus) => parts.push(format!("genus {genus}")),
            None => parts.push(format!("Euler characteristic {}", d.euler_characteristic)),
        }
        if !d.orientable {
            parts.push("not orientable".to_owned());
        }
        parts.join(", ")
    }
}

impl Facts<'_> {
    fn drawn_triangles(&self) -> usize {
        self.asset.instances.iter().map(|instance| self.asset.meshes[instance.mesh].mesh.triangle_count()).sum()
    }

    fn sum(&self, count: fn(&Mesh) -> usize) -> usize {
        self.meshes.iter().map(|facts| count(facts.mesh)).sum()
    }

    fn diagonal(&self) -> f64 {
        self.bounds.map_or(0.0, |(low, high)| (Vec3::from(high).as_dvec3() - Vec3::from(low).as_dvec3()).length())
    }

    fn json(&self) -> Value {
        let contents: Map<String, Value> =
            self.asset.contents().into_iter().map(|(name, count)| (name.to_owned(), count.into())).collect();
        let skinned = self.asset.instances.iter().filter(|instance| instance.joint_matrices.is_some()).count();
        json!({
            "file": self.file,
            "format": super::format_name(self.format),
            "bytes": self.bytes,
            "triangles": self.sum(Mesh::triangle_count),
            "vertices": self.sum(Mesh::vertex_count),
            "wedges": self.sum(Mesh::wedge_count),
            "instances": self.asset.instances.len(),
            "skinned_instances": skinned,
            "drawn_triangles": self.drawn_triangles(),
            "bounds": bounds_json(self.bounds),
            "diagonal": self.diagonal(),
            "area": self.area,
            "volume": self.volume,
            "contents": contents,
            "levels": self.levels,
            "progressive": self.progressive.as_ref().map(ProgressiveFacts::json),
            "meshes": self.meshes.iter().map(MeshFacts::json).collect::<Vec<_>>(),
            "warnings": self.asset.warnings,
        })
    }

    fn text(&self) -> String {
        let mut listing = Listing::default();
        listing.heading(format!("{}: {}, {}", self.file, super::format_name(self.format), output::bytes(self.bytes)));
        let count = |n: usize| output::count(n);
        let drawn = match self.is_drawn_as_is {
            true => String::new(),
            false => format!(
                ", {} drawn in {}",
                count(self.drawn_triangles()),
                plural(self.asset.instances.len(), "instance")
            ),
        };
        let triangles = count(self.sum(Mesh::triangle_count));
        listing.line("content", format!("{triangles} triangles in {}{drawn}", plural(self.meshes.len(), "mesh")));
        if let Some(progressive) = &self.progressive {
            progressive.describe(&mut listing);
        }
        for (name, count) in self.asset.contents() {
            listing.line(name, count.to_string());
        }
        if !self.levels.is_empty() {
            let levels: Vec<String> = self.levels.iter().map(|&triangles| count(triangles)).collect();
            listing.line("levels of detail", format!("{} triangles, and the original", levels.join(", ")));
        }
        if let Some((low, high)) = self.bounds {
            let corner = |p: [f32; 3]| p.map(|x| output::number(f64::from(x))).join(", ");
            listing.line("bounds", format!("({}) to ({})", corner(low), corner(high)));
            listing.line("diagonal", output::number(self.diagonal()));
            listing.line("area", output::number(self.area));
        }
        if self.meshes.iter().all(|mesh| mesh.diagnosis.closed) {
            listing.line("volume", output::number(self.volume));
        }
        for warning in &self.asset.warnings {
            listing.line("warning", warning);
        }
        for (index, mesh) in self.meshes.iter().enumerate() {
            mesh.describe(&mut listing, index, self.is_drawn_as_is);
        }
        listing.text()
    }
}

fn bounds_json(bounds: Option<([f32; 3], [f32; 3])>) -> Value {
    bounds.map_or(Value::Null, |(low, high)| json!({ "min": low, "max": high }))
}

/// Smallest and largest value of each component, of those that are finite.
fn ranges(attribute: &Attribute) -> Vec<(f64, f64)> {
    fn of<T: Copy + Into<f64>>(values: &[T], components: usize) -> Vec<(f64, f64)> {
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); components];
        for element in values.chunks_exact(components) {
            for (range, &value) in ranges.iter_mut().zip(element) {
                let value: f64 = value.into();
                if value.is_finite() {
                    *range = (range.0.min(value), range.1.max(value));
                }
            }
        }
        ranges
    }
    match &attribute.values {
        Values::F32(values) => of(values, attribute.components),
        Values::U32(values) => of(values, attribute.components),
    }
}

fn attribute_json(on: &str, attribute: &Attribute) -> Value {
    let ranges = ranges(attribute);
    json!({
        "name": attribute.semantic.to_string(),
        "on": on,
        "components": attribute.components,
        "type": format!("{:?}", attribute.storage.component).to_lowercase(),
        "normalized": attribute.storage.normalized,
        "min": ranges.iter().map(|range| range.0).collect::<Vec<_>>(),
        "max": ranges.iter().map(|range| range.1).collect::<Vec<_>>(),
    })
}

fn attribute_text(attribute: &Attribute) -> String {
    let storage = format!("{:?}", attribute.storage.component).to_lowercase();
    let shown = ranges(attribute).into_iter().take(4).map(|(low, high)| match low <= high {
        true => format!("{}..{}", output::number(low), output::number(high)),
        false => "none".to_owned(),
    });
    let more = if attribute.components > 4 { " ..." } else { "" };
    format!("{} x {storage}: {}{more}", attribute.components, shown.collect::<Vec<_>>().join(" "))
}

/// A few names in brackets.
fn names(names: &[String]) -> String {
    const SHOWN: usize = 6;
    let mut shown: Vec<&str> = names.iter().map(String::as_str).filter(|name| !name.is_empty()).take(SHOWN).collect();
    if names.len() > SHOWN && !shown.is_empty() {
        shown.push("...");
    }
    if shown.is_empty() { String::new() } else { format!("({})", shown.join(", ")) }
}

fn plural(count: usize, what: &str) -> String {
    let ending = match count {
        1 => "",
        _ if what.ends_with("sh") => "es",
        _ => "s",
    };
    format!("{} {what}{ending}", output::count(count))
}
