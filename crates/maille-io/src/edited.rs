//! Levels that come from other files.

use std::collections::HashMap;
use std::hash::Hash;

use maille::mesh::Values;
use maille::{Mesh, Semantic};

use crate::asset::Source;
use crate::{Asset, NamedMesh};

impl Asset {
    /// The meshes of another file as a level of this asset, one for each of [`meshes`](Self::meshes): say, a level that was
    /// edited by hand. They are known by their names (`NAME_LOD2` stands for `NAME`), or by their order if there are as
    /// many and names do not tell; their materials and joints by their names.
    ///
    /// # Errors
    /// In words, if a mesh, a material or a joint is not found.
    pub fn level_from(&self, file: &Self) -> Result<Vec<Mesh>, String> {
        let whole;
        let file = match file.split_levels() {
            Some(split) => {
                whole = split?.0;
                &whole
            }
            None => file,
        };
        let found = self.matches_in(file)?;
        self.meshes
            .iter()
            .zip(found)
            .enumerate()
            .map(|(i, (named, other))| {
                let mut mesh = file.meshes[other].mesh.clone();
                let of_mesh = |what: String| format!("{what}, in the mesh that stands for '{}'", named.name);
                self.rename_slots(i, &mut mesh, &file.slot_names(other)).map_err(of_mesh)?;
                rename_joints(&mut mesh, &self.joint_names(i), &file.joint_names(other)).map_err(of_mesh)?;
                Ok(mesh)
            })
            .collect()
    }

    /// The mesh of a file that stands for each of one's own.
    fn matches_in(&self, file: &Self) -> Result<Vec<usize>, String> {
        let names =
            |asset: &Self| asset.meshes.iter().map(|named| base_name(named).to_owned()).collect::<Vec<String>>();
        let (own, theirs) = (names(self), names(file));
        let places = places_of(&theirs);
        let by_name: Option<Vec<usize>> = own.iter().map(|name| places.get(name).copied().flatten()).collect();
        let are_told_apart = places_of(&own).values().all(Option::is_some);
        match by_name.filter(|_| are_told_apart) {
            Some(found) => Ok(found),
            None if own.len() == theirs.len() => Ok((0..own.len()).collect()),
            None => {
                let missing = own.iter().find(|name| !matches!(places.get(*name), Some(Some(_))));
                let name = missing.or(own.first()).map_or("", String::as_str);
                Err(format!("no mesh is named '{name}', and there are {} meshes, not {}", theirs.len(), own.len()))
            }
        }
    }

    /// Lets the triangles of a mesh from elsewhere have the material slots of one's own mesh.
    fn rename_slots(&self, own: usize, mesh: &mut Mesh, theirs: &[String]) -> Result<(), String> {
        let known = self.slot_names(own);
        let slot_of = |slot: usize| {
            let name = theirs.get(slot).map_or("", String::as_str);
            let same = known.iter().position(|known| known == name);
            let by_order =
                Some(slot).filter(|&slot| slot < known.len().max(1) && (name.is_empty() || known.len() <= 1));
            same.or(by_order).ok_or_else(|| format!("there is no material '{name}'; there are: {}", known.join(", ")))
        };
        let slots: Result<Vec<u32>, String> =
            (0..mesh.triangle_count()).map(|t| Ok(slot_of(mesh.triangle_material(t) as usize)? as u32)).collect();
        let slots = slots?;
        mesh.triangle_materials = if slots.iter().all(|&slot| slot == 0) { Vec::new() } else { slots };
        mesh.material_names = self.meshes[own].mesh.material_names.clone();
        Ok(())
    }

    /// What the material slots of a mesh are called.
    fn slot_names(&self, mesh: usize) -> Vec<String> {
        match &self.source {
            Source::Gltf(document) => document.slot_names(mesh),
            _ => self.meshes[mesh].mesh.material_names.clone(),
        }
    }

    /// What the joints of a mesh are called; empty if none move it.
    fn joint_names(&self, mesh: usize) -> Vec<String> {
        match &self.source {
            Source::Gltf(document) => document.joint_names(mesh),
            _ => Vec::new(),
        }
    }
}

/// The name of a mesh without the number of its level.
fn base_name(named: &NamedMesh) -> &str {
    match named.name.rsplit_once("_LOD") {
        Some((base, number)) if !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()) => base,
        _ => &named.name,
    }
}

/// Where each of some names is; `None` for one that comes more than once.
fn places_of<T: Eq + Hash + Clone>(names: &[T]) -> HashMap<T, Option<usize>> {
    let mut places = HashMap::new();
    for (i, name) in names.iter().enumerate() {
        places.entry(name.clone()).and_modify(|place| *place = None).or_insert(Some(i));
    }
    places
}

/// Lets a mesh name joints by their numbers in another skin that has joints of the same names.
fn rename_joints(mesh: &mut Mesh, own: &[String], theirs: &[String]) -> Result<(), String> {
    if own == theirs {
        return Ok(());
    }
    let is_moved = mesh.wedge_attributes.iter().any(|attribute| matches!(attribute.semantic, Semantic::Joints(_)));
    if own.is_empty() && !is_moved {
        return Ok(());
    }
    if theirs.is_empty() || !is_moved {
        return Err("no joints move the surface, as they should".to_owned());
    }
    let places = places_of(own);
    let numbers: Vec<Option<usize>> = theirs.iter().map(|name| places.get(name).copied().flatten()).collect();
    let joints = |attribute: &&mut maille::Attribute| matches!(attribute.semantic, Semantic::Joints(_));
    for attribute in mesh.wedge_attributes.iter_mut().filter(joints) {
        let Values::U32(values) = &mut attribute.values else { continue };
        for value in values {
            let known = numbers.get(*value as usize).copied().flatten();
            *value = match (known, *value) {
                (Some(number), _) => number as u32,
                (None, 0) => 0, // often names nothing
                (None, joint) => {
                    let name = theirs.get(joint as usize).map_or("", String::as_str);
                    return Err(format!("there is no joint '{name}' (number {joint})"));
                }
            };
        }
    }
    Ok(())
}
