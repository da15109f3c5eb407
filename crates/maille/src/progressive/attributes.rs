//! The attributes of a progressive mesh, as steps want them.

use super::Counts;
use crate::mesh::{Attribute, Mesh, MorphTarget, Values};
use crate::prefetch::prefetch;
use crate::simplify::{Rows, attributes_of_wedges, attributes_of_wedges_mut};

/// Attributes of wedges and vertices, their values interleaved.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Attributes {
    /// All but the values of them.
    pub(super) wedges: Vec<Attribute>,
    pub(super) morph_targets: Vec<MorphTarget>,
    pub(super) vertices: Vec<Attribute>,
    /// Of wedges, those of morph targets after their own.
    pub(super) wedge_values: Table,
    pub(super) vertex_values: Table,
}

/// Values of some attributes for many elements, all those of an element side by side, so that a step finds them in one place:
/// words of 32 bits, of floats their bits.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Table {
    /// Words to an element.
    pub(super) width: usize,
    pub(super) words: Vec<u32>,
}

impl Attributes {
    /// Takes them out of a mesh.
    pub(super) fn take_from(mesh: &mut Mesh) -> Self {
        let wedge_values = Table::of(attributes_of_wedges(mesh).map(column));
        let vertex_values = Table::of(mesh.vertex_attributes.iter().map(column));
        attributes_of_wedges_mut(mesh).for_each(clear);
        mesh.vertex_attributes.iter_mut().for_each(clear);
        Self {
            wedges: std::mem::take(&mut mesh.wedge_attributes),
            morph_targets: std::mem::take(&mut mesh.morph_targets),
            vertices: std::mem::take(&mut mesh.vertex_attributes),
            wedge_values,
            vertex_values,
        }
    }

    /// Gives those of a level to its mesh.
    pub(super) fn give_to(&self, mesh: &mut Mesh, level: Counts) {
        mesh.wedge_attributes = self.wedges.clone();
        mesh.morph_targets = self.morph_targets.clone();
        mesh.vertex_attributes = self.vertices.clone();
        self.wedge_values.give_to(attributes_of_wedges_mut(mesh), level.wedges as usize);
        self.vertex_values.give_to(mesh.vertex_attributes.iter_mut(), level.vertices as usize);
    }

    /// Values of wedges and of vertices that were recorded.
    pub(super) fn tables_of(mesh: &Mesh, wedges: &Rows, vertices: &Rows) -> [Table; 2] {
        let columns = |components: Vec<usize>, rows: &Rows| Table::of(components.into_iter().zip(&rows.0));
        let components = attributes_of_wedges(mesh).map(|attribute| attribute.components).collect();
        let of_vertices = mesh.vertex_attributes.iter().map(|attribute| attribute.components).collect();
        [columns(components, wedges), columns(of_vertices, vertices)]
    }
}

fn column(attribute: &Attribute) -> (usize, &Values) {
    (attribute.components, &attribute.values)
}

fn clear(attribute: &mut Attribute) {
    match &mut attribute.values {
        Values::F32(values) => *values = Vec::new(),
        Values::U32(values) => *values = Vec::new(),
    }
}

impl Table {
    /// Interleaves columns, given with how many components each has.
    fn of<'v>(columns: impl Iterator<Item = (usize, &'v Values)>) -> Self {
        let columns: Vec<(usize, &Values)> = columns.collect();
        let width = columns.iter().map(|(components, _)| components).sum();
        let count = columns.first().map_or(0, |(components, values)| values.len() / components);
        let mut table = Self { width, words: vec![0; width * count] };
        let mut first = 0;
        for (components, values) in columns {
            match values {
                Values::F32(values) => table.put(first, components, values, |value| value.to_bits()),
                Values::U32(values) => table.put(first, components, values, |value| value),
            }
            first += components;
        }
        table
    }

    fn put<T: Copy>(&mut self, first: usize, components: usize, values: &[T], word: impl Fn(T) -> u32) {
        for (row, element) in self.words.chunks_exact_mut(self.width).zip(values.chunks_exact(components)) {
            row[first..].iter_mut().zip(element).for_each(|(into, &value)| *into = word(value));
        }
    }

    /// Gives the values of the first elements to their attributes.
    fn give_to<'a>(&self, attributes: impl Iterator<Item = &'a mut Attribute>, count: usize) {
        let mut first = 0;
        for attribute in attributes {
            let columns = first..first + attribute.components;
            let words = self.words.chunks_exact(self.width).take(count).flat_map(|row| &row[columns.clone()]).copied();
            match &mut attribute.values {
                Values::F32(values) => *values = words.map(f32::from_bits).collect(),
                Values::U32(values) => *values = words.collect(),
            }
            first = columns.end;
        }
    }

    /// Exchanges some elements with the rows of another table from `first` on.
    #[inline]
    pub(super) fn exchange(&mut self, elements: &[u32], others: &mut Self, first: usize) {
        let width = self.width;
        let others = &mut others.words[first * width..][..elements.len() * width];
        for (&element, other) in elements.iter().zip(others.chunks_exact_mut(width)) {
            let (ours, our_rest) = self.words[element as usize * width..][..width].as_chunks_mut::<4>();
            let (theirs, their_rest) = other.as_chunks_mut::<4>();
            ours.iter_mut().zip(theirs).for_each(|(a, b)| std::mem::swap(a, b));
            our_rest.iter_mut().zip(their_rest).for_each(|(a, b)| std::mem::swap(a, b));
        }
    }

    #[inline]
    pub(super) fn prefetch(&self, elements: &[u32]) {
        for &element in elements {
            let start = element as usize * self.width;
            prefetch(&self.words, start);
            prefetch(&self.words, start + self.width - 1);
        }
    }
}
