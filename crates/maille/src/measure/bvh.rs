//! A hierarchy of boxes over the triangles of a mesh, for closest points.
//!
//! Ours and not parry3d's: measuring wants millions of queries a second from points that follow each other along the
//! surface, so the search keeps the last answer as its first guess; boxes are `f32` (tested four at a time) and the
//! triangle test is `f64`; meshes of any size and offset are to work without scaling them first.

use glam::{DVec3, Vec3A, Vec4};
use rayon::prelude::*;

use super::triangle::{OnTriangle, closest_on_triangle};
use crate::Mesh;

/// Most triangles in a leaf. On a noisy torus of a million triangles 2, 3, 4 and 6 give 1.57, 1.47, 1.33 and 1.23
/// million searches a second at 52, 46, 35 and 30 bytes per triangle. Testing each triangle's own box first does not pay.
const LEAF_SIZE: usize = 4;
/// Bins of the split search; 8 to 32 give nearly the same trees.
const BINS: usize = 16;
/// Below this depth ranges are halved, which bounds the depth of the tree whatever the triangles are.
const MAX_UNBALANCED_DEPTH: u32 = 40;
/// Ranges larger than this are built in parallel.
const PARALLEL_SIZE: usize = 8192;
/// `Node::count` of a lane that has no child.
const EMPTY: u8 = u8::MAX;

/// The point of a surface nearest to some query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// The triangle it lies on.
    pub triangle: u32,
    /// Its weights at the triangle's corners, 0 to 1, with sum 1.
    pub barycentric: [f64; 3],
    /// Where it is, in model units.
    pub point: DVec3,
    /// Its squared distance from the query, in squared model units.
    pub distance_sq: f64,
}

/// Four boxes and what is in them, in the tree's frame. Arrays by axis, lanes by child.
///
/// A child is a node (`count` 0, `link` its distance behind this one in the array, so that subtrees can be built apart
/// and put together as they are) or a leaf (`count` slots from `link` on).
#[derive(Debug, Clone, Copy)]
struct Node {
    low: [Vec4; 3],
    high: [Vec4; 3],
    link: [u32; 4],
    count: [u8; 4],
}

/// A triangle in the order of the leaves.
#[derive(Debug, Clone, Copy)]
struct Slot {
    vertices: [u32; 3],
    triangle: u32,
}

/// A hierarchy of boxes over the triangles of a mesh that finds the closest point of the surface.
///
/// Triangles with a corner that is not finite are left out; degenerate ones are fine. Any scale and offset that `f32`
/// positions can have works: boxes are rounded outwards in a frame of their own, distances are `f64`.
///
/// Cost: O(n log n) time and some 35 bytes per triangle (and twice that while it is built); a query near the surface
/// takes O(log n) time, less than a microsecond with a good guess (see [`Searcher`]).
///
/// The tree is the same for any number of threads. Splits: Wald, "On fast construction of SAH-based bounding volume
/// hierarchies", 2007 (16 bins along the longest side); four children to a node.
///
/// ```
/// let sphere = maille::mesh::shapes::sphere(4);
/// let bvh = maille::measure::Bvh::new(&sphere);
/// let found = bvh.closest(glam::DVec3::new(0.0, 0.0, 3.0)).expect("the mesh is not empty");
/// assert!((found.distance_sq - 4.0).abs() < 1e-6);
/// ```
#[derive(Debug)]
pub struct Bvh<'m> {
    positions: &'m [[f32; 3]],
    nodes: Vec<Node>,
    slots: Vec<Slot>,
    frame: Frame,
}

impl<'m> Bvh<'m> {
    /// Builds the hierarchy of a mesh.
    ///
    /// # Panics
    /// If an index is out of range ([`Mesh::check`] finds that out).
    pub fn new(mesh: &'m Mesh) -> Self {
        Self::build(&mesh.positions, mesh.triangle_count(), |t| mesh.triangle_vertices(t))
    }

    /// Builds the hierarchy of triangles between positions.
    ///
    /// # Panics
    /// If an index is out of range.
    pub(crate) fn of_triangles(positions: &'m [[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        Self::build(positions, triangles.len(), |t| triangles[t])
    }

    fn build(positions: &'m [[f32; 3]], count: usize, vertices: impl Fn(usize) -> [u32; 3] + Sync) -> Self {
        let corners = |t: u32| corners(positions, vertices(t as usize));
        let frame = Frame::around(count, corners);
        let item = |t: u32| Item::new(t, corners(t), &frame);
        let mut items: Vec<Item> = (0..count as u32).into_par_iter().filter_map(item).collect();
        let mut nodes = Vec::new();
        if !items.is_empty() {
            let range = Range { bounds: bounds_of(&items), first: 0, items: &mut items };
            build(range, 0, &mut nodes);
        }
        let slot = |item: &Item| Slot { vertices: vertices(item.triangle as usize), triangle: item.triangle };
        Self { positions, nodes, slots: items.par_iter().map(slot).collect(), frame }
    }

    /// The point of the surface nearest to `p`, `None` if the mesh has no triangles or `p` is not finite. For
    /// many points, see [`Searcher`].
    pub fn closest(&self, p: DVec3) -> Option<ClosestPoint> {
        self.searcher().closest(p)
    }

    /// A search that remembers its last answer.
    pub fn searcher(&self) -> Searcher<'_> {
        Searcher { bvh: self, stack: Vec::with_capacity(64), last: 0 }
    }

    /// All triangles in the order of the leaves: neighbours in this order are mostly neighbours in space.
    pub fn triangles_in_space_order(&self) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.slots.iter().map(|slot| slot.triangle)
    }

    /// Length of the diagonal of the box around all triangles, in model units.
    pub fn diagonal(&self) -> f64 {
        (self.frame.high - self.frame.low).length()
    }

    /// Bytes that the hierarchy takes beyond the mesh.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.nodes) + size_of_val(&*self.slots)
    }

    fn nearest_on_slot(&self, slot: u32, p: DVec3) -> OnTriangle {
        closest_on_triangle(p, self.corners(slot))
    }

    /// The triangle in a place of the order of the leaves.
    pub(super) fn triangle_at(&self, slot: u32) -> u32 {
        self.slots[slot as usize].triangle
    }

    /// Gathers the places (in the order of the leaves) of the triangles whose boxes meet the given one and that are
    /// wanted; false, and not all of them, when those are more than `most`, or many times as many have to be looked at.
    pub(super) fn gather(
        &self,
        [low, high]: [DVec3; 2],
        is_wanted: impl Fn([DVec3; 3]) -> bool,
        most: usize,
        places: &mut Vec<u32>,
    ) -> bool {
        let mut patience = 16 * most;
        places.clear();
        if self.slots.is_empty() {
            return true;
        }
        let query = Query::of_box(low, high, &self.frame);
        let mut stack = Vec::with_capacity(64);
        stack.push(0);
        while let Some(id) = stack.pop() {
            let node = &self.nodes[id as usize];
            let met = query.meets(node);
            for (lane, _) in met.iter().enumerate().filter(|(_, met)| **met) {
                let (count, link) = (node.count[lane], node.link[lane]);
                if count == EMPTY {
                    continue;
                }
                if count == 0 {
                    stack.push(id + link);
                    continue;
                }
                for slot in link..link + u32::from(count) {
                    let [a, b, c] = self.corners(slot);
                    let (least, greatest) = (a.min(b).min(c), a.max(b).max(c));
                    if least.cmple(high).all() && greatest.cmpge(low).all() && is_wanted([a, b, c]) {
                        if places.len() == most {
                            return false;
                        }
                        places.push(slot);
                    }
                }
                patience = patience.saturating_sub(count.into());
                if patience == 0 {
                    return false;
                }
            }
        }
        true
    }

    /// Corners of the triangle in a place of the order of the leaves.
    #[inline]
    pub(crate) fn corners(&self, slot: u32) -> [DVec3; 3] {
        corners(self.positions, self.slots[slot as usize].vertices)
    }
}

#[inline]
fn corners(positions: &[[f32; 3]], [a, b, c]: [u32; 3]) -> [DVec3; 3] {
    let position = |v: u32| glam::Vec3::from(positions[v as usize]).as_dvec3();
    [position(a), position(b), position(c)]
}

/// Finds closest points one after the other, each with the triangle of the one before as its first guess.
///
/// Made by [`Bvh::searcher`]. Give it points that follow each other in space: the guess then bounds the search to a few
/// boxes. The guess never changes the distance found, only (where several triangles are equally near, as on their
/// common edge) which of them is named; so the same points in the same order give the same answers.
#[derive(Debug)]
pub struct Searcher<'b> {
    bvh: &'b Bvh<'b>,
    stack: Vec<Pending>,
    last: u32,
}

/// A child not visited yet and a lower bound of its squared distance, in the tree's frame.
#[derive(Debug, Clone, Copy)]
struct Pending {
    distance_sq: f32,
    link: u32,
    count: u8,
}

impl Searcher<'_> {
    /// The point of the surface nearest to `p`, `None` if the mesh has no triangles or `p` is not finite.
    pub fn closest(&mut self, p: DVec3) -> Option<ClosestPoint> {
        let (barycentric, distance_sq) = self.search(p, 0.0)?;
        let point = super::triangle::at(self.bvh.corners(self.last), barycentric);
        let triangle = self.bvh.slots[self.last as usize].triangle;
        Some(ClosestPoint { triangle, barycentric, point, distance_sq })
    }

    /// The place (in the order of the leaves) of the triangle nearest to `p`, or of one that is no farther than the root of
    /// `enough_sq`, and its squared distance; the triangle in another place is the first guess.
    pub(crate) fn close_place(&mut self, p: DVec3, guess: u32, enough_sq: f64) -> Option<(u32, f64)> {
        self.last = guess;
        let (_, distance_sq) = self.search(p, enough_sq)?;
        Some((self.last, distance_sq))
    }

    /// The place found last, in the order of the leaves.
    pub(crate) fn last_place(&self) -> u32 {
        self.last
    }

    fn search(&mut self, p: DVec3, enough_sq: f64) -> Option<OnTriangle> {
        if self.bvh.slots.is_empty() || !p.is_finite() {
            return None;
        }
        let mut best = self.bvh.nearest_on_slot(self.last, p);
        if best.1 <= enough_sq {
            return Some(best);
        }
        let query = Query::new(p, &self.bvh.frame);
        let mut limit = query.limit(best.1);
        self.stack.clear();
        self.push_children(0, &query, limit);
        while let Some(next) = self.stack.pop() {
            if next.distance_sq > limit {
                continue;
            }
            if next.count == 0 {
                self.push_children(next.link, &query, limit);
                continue;
            }
            for slot in next.link..next.link + u32::from(next.count) {
                let found = self.bvh.nearest_on_slot(slot, p);
                if found.1 < best.1 {
                    (best, self.last) = (found, slot);
                    if best.1 <= enough_sq {
                        return Some(best);
                    }
                    limit = query.limit(best.1);
                }
            }
        }
        Some(best)
    }

    /// Puts the children of a node that are within the limit on the stack, the nearest on top.
    fn push_children(&mut self, id: u32, query: &Query, limit: f32) {
        let node = &self.bvh.nodes[id as usize];
        let distances_sq = query.distances_sq(node).to_array();
        let bottom = self.stack.len();
        for (lane, &distance_sq) in distances_sq.iter().enumerate() {
            let count = node.count[lane];
            if distance_sq <= limit && count != EMPTY {
                let link = if count == 0 { id + node.link[lane] } else { node.link[lane] };
                let mut place = self.stack.len();
                self.stack.push(Pending { distance_sq, link, count });
                while place > bottom && self.stack[place - 1].distance_sq < distance_sq {
                    self.stack.swap(place - 1, place);
                    place -= 1;
                }
            }
        }
    }
}

/// A point to search from, ready to be tested against boxes: the least and the greatest `f32` coordinates it may have.
struct Query {
    low: [Vec4; 3],
    high: [Vec4; 3],
    /// From squared model units to squared units of the frame.
    scale_sq: f64,
}

impl Query {
    fn new(p: DVec3, frame: &Frame) -> Self {
        let local = frame.local(p).to_array();
        Self {
            low: local.map(|x| Vec4::splat(round_down(x))),
            high: local.map(|x| Vec4::splat(round_up(x))),
            scale_sq: frame.scale * frame.scale,
        }
    }

    fn of_box(low: DVec3, high: DVec3, frame: &Frame) -> Self {
        let [low, high] = [low, high].map(|p| frame.local(p).to_array());
        Self {
            low: low.map(|x| Vec4::splat(round_down(x))),
            high: high.map(|x| Vec4::splat(round_up(x))),
            scale_sq: frame.scale * frame.scale,
        }
    }

    /// Which of a node's boxes the query's box meets.
    fn meets(&self, node: &Node) -> [bool; 4] {
        let axis = |i: usize| node.low[i].cmple(self.high[i]) & node.high[i].cmpge(self.low[i]);
        (axis(0) & axis(1) & axis(2)).into()
    }

    /// Lower bounds of the squared distances to a node's four boxes, but for the rounding that [`limit`](Self::limit)
    /// allows for.
    fn distances_sq(&self, node: &Node) -> Vec4 {
        let axis = |i: usize| {
            let distance = (node.low[i] - self.high[i]).max(self.low[i] - node.high[i]).max(Vec4::ZERO);
            distance * distance
        };
        axis(0) + axis(1) + axis(2)
    }

    /// The bound above which boxes cannot hold anything nearer than `distance_sq` (in squared model units).
    ///
    /// The sum of three squared differences has five roundings of at most 2^-24 each way, two more are made here: one
    /// part in a million is more than all of them. The least addend keeps squares that underflow within the bound.
    fn limit(&self, distance_sq: f64) -> f32 {
        round_up(distance_sq * self.scale_sq * 1.000_001) + f32::MIN_POSITIVE
    }
}

/// The frame of the boxes: the origin at the middle of the mesh, its largest extent between 1 and 2. Scaling is by a
/// power of two, and so exact.
#[derive(Debug, Clone, Copy)]
struct Frame {
    low: DVec3,
    high: DVec3,
    scale: f64,
}

impl Frame {
    fn around(triangles: usize, corners: impl Fn(u32) -> [DVec3; 3] + Sync) -> Self {
        let bounds = (0..triangles as u32)
            .into_par_iter()
            .map(&corners)
            .filter(|corners| corners.iter().all(|p| p.is_finite()))
            .map(|[a, b, c]| (a.min(b).min(c), a.max(b).max(c)))
            .reduce_with(|(low, high), (l, h)| (low.min(l), high.max(h)));
        let (low, high) = bounds.unwrap_or_default();
        let extent = (high - low).max_element();
        let scale = if extent > 0.0 { (-extent.log2().floor()).exp2() } else { 1.0 };
        Self { low, high, scale }
    }

    fn local(&self, p: DVec3) -> DVec3 {
        (p - (self.low + self.high) * 0.5) * self.scale
    }
}

/// The largest `f32` not above `x`.
fn round_down(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

/// The smallest `f32` not below `x`.
fn round_up(x: f64) -> f32 {
    -round_down(-x)
}

/// A box in the tree's frame.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    const EMPTY: Self = Self { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    #[inline]
    fn union(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Half the surface, 0 for the empty box.
    #[inline]
    fn half_area(&self) -> f32 {
        let [x, y, z] = (self.high - self.low).max(Vec3A::ZERO).to_array();
        x * y + y * z + z * x
    }
}

fn bounds_of(items: &[Item]) -> Bounds {
    items.iter().fold(Bounds::EMPTY, |bounds, item| bounds.union(&item.bounds()))
}

/// A triangle while the tree is built: its box, packed.
#[derive(Debug, Clone, Copy)]
struct Item {
    low: [f32; 3],
    high: [f32; 3],
    triangle: u32,
}

impl Item {
    /// `None` if a corner is not finite.
    fn new(triangle: u32, corners: [DVec3; 3], frame: &Frame) -> Option<Self> {
        let [a, b, c] = corners.map(|p| frame.local(p));
        let low = a.min(b).min(c).to_array().map(round_down);
        let high = a.max(b).max(c).to_array().map(round_up);
        corners.iter().all(|p| p.is_finite()).then_some(Self { low, high, triangle })
    }

    #[inline]
    fn bounds(&self) -> Bounds {
        Bounds { low: self.low.into(), high: self.high.into() }
    }

    /// Twice the middle of the box.
    #[inline]
    fn centre(&self, axis: usize) -> f32 {
        self.low[axis] + self.high[axis]
    }
}

/// Triangles that go into one child; `first` is the place of the first among all.
struct Range<'i> {
    bounds: Bounds,
    first: u32,
    items: &'i mut [Item],
}

impl Range<'_> {
    fn is_leaf(&self) -> bool {
        self.items.len() <= LEAF_SIZE
    }

    /// Splits in two where the surface area heuristic says, or in halves when there is no such place or `balanced`.
    fn split(self, balanced: bool) -> (Self, Self) {
        let (axis, low, extent) = longest_side_of_centres(self.items);
        let plane = if balanced { None } else { Bins::fill(self.items, axis, low, extent).cheapest_split() };
        let (middle, bounds) = match plane {
            Some((bin, left, right)) => {
                (partition(self.items, |item| Bins::of(item, axis, low, extent) < bin), [left, right])
            }
            None => {
                let middle = self.items.len() / 2;
                let key = |item: &Item| (item.centre(axis), item.triangle);
                self.items.select_nth_unstable_by(middle, |a, b| {
                    let ((x, i), (y, j)) = (key(a), key(b));
                    x.total_cmp(&y).then(i.cmp(&j))
                });
                (middle, [bounds_of(&self.items[..middle]), bounds_of(&self.items[middle..])])
            }
        };
        let (left, right) = self.items.split_at_mut(middle);
        let second = self.first + middle as u32;
        (
            Self { bounds: bounds[0], first: self.first, items: left },
            Self { bounds: bounds[1], first: second, items: right },
        )
    }
}

/// The axis along which the centres spread most, their least coordinate and their extent there.
fn longest_side_of_centres(items: &[Item]) -> (usize, f32, f32) {
    let centres = items.iter().map(Item::bounds).map(|b| b.low + b.high);
    let range = |(low, high): (Vec3A, Vec3A), centre: Vec3A| (low.min(centre), high.max(centre));
    let (low, high) = centres.fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), range);
    let extent = high - low;
    let axis = (1..3).fold(0, |longest, axis| if extent[axis] > extent[longest] { axis } else { longest });
    (axis, low[axis], extent[axis])
}

/// Moves the items that belong left to the front and returns how many they are. Not stable, but always the same.
fn partition(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let (mut left, mut right) = (0, items.len());
    while left < right {
        if is_left(&items[left]) {
            left += 1;
        } else {
            right -= 1;
            items.swap(left, right);
        }
    }
    left
}

/// How many items have their centre in each slice of the range, and their boxes.
struct Bins {
    counts: [u32; BINS],
    bounds: [Bounds; BINS],
}

impl Bins {
    #[inline]
    fn of(item: &Item, axis: usize, low: f32, extent: f32) -> usize {
        // the cast takes 0/0 to 0
        let bin = ((item.centre(axis) - low) / extent * BINS as f32) as i32;
        bin.clamp(0, BINS as i32 - 1) as usize
    }

    fn fill(items: &[Item], axis: usize, low: f32, extent: f32) -> Self {
        let mut bins = Self { counts: [0; BINS], bounds: [Bounds::EMPTY; BINS] };
        for item in items {
            let bin = Self::of(item, axis, low, extent);
            bins.counts[bin] += 1;
            bins.bounds[bin] = bins.bounds[bin].union(&item.bounds());
        }
        bins
    }

    /// The first bin of the right part and the boxes of both parts; `None` when all items are in one bin.
    fn cheapest_split(&self) -> Option<(usize, Bounds, Bounds)> {
        let add =
            |(count, bounds): (u32, Bounds), bin: usize| (count + self.counts[bin], bounds.union(&self.bounds[bin]));
        let mut from = [(0, Bounds::EMPTY); BINS + 1];
        for bin in (0..BINS).rev() {
            from[bin] = add(from[bin + 1], bin);
        }
        let mut best = None;
        let mut least = f32::INFINITY;
        let mut left = (0, Bounds::EMPTY);
        for (bin, right) in from.iter().enumerate().take(BINS).skip(1) {
            left = add(left, bin - 1);
            let cost = left.1.half_area() * left.0 as f32 + right.1.half_area() * right.0 as f32;
            if left.0 > 0 && right.0 > 0 && cost < least {
                (best, least) = (Some((bin, left.1, right.1)), cost);
            }
        }
        best
    }
}

/// Appends the nodes of a range to `nodes`, its root first.
fn build(range: Range<'_>, depth: u32, nodes: &mut Vec<Node>) {
    let is_large = range.items.len() > PARALLEL_SIZE;
    let children = children_of(range, depth >= MAX_UNBALANCED_DEPTH);
    let id = nodes.len();
    nodes.push(Node {
        low: [0, 1, 2].map(|axis| lanes(&children, |child| child.bounds.low[axis], f32::INFINITY)),
        high: [0, 1, 2].map(|axis| lanes(&children, |child| child.bounds.high[axis], f32::NEG_INFINITY)),
        link: [0; 4],
        count: [EMPTY; 4],
    });
    for (lane, child) in children.iter().enumerate() {
        (nodes[id].link[lane], nodes[id].count[lane]) =
            if child.is_leaf() { (child.first, child.items.len() as u8) } else { (0, 0) };
    }
    let inner = children.into_iter().enumerate().filter(|(_, child)| !child.is_leaf());
    if is_large {
        let built: Vec<(usize, Vec<Node>)> = inner
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(lane, child)| {
                let mut nodes = Vec::new();
                build(child, depth + 1, &mut nodes);
                (lane, nodes)
            })
            .collect();
        for (lane, subtree) in built {
            nodes[id].link[lane] = (nodes.len() - id) as u32;
            nodes.extend(subtree);
        }
    } else {
        for (lane, child) in inner {
            nodes[id].link[lane] = (nodes.len() - id) as u32;
            build(child, depth + 1, nodes);
        }
    }
}

/// Splits a range into up to four, always the one with the largest box.
fn children_of(range: Range<'_>, balanced: bool) -> Vec<Range<'_>> {
    let mut children = Vec::with_capacity(4);
    children.push(range);
    while children.len() < 4 {
        let splittable = children.iter().enumerate().filter(|(_, child)| !child.is_leaf());
        let size = |child: &Range<'_>| if balanced { child.items.len() as f32 } else { child.bounds.half_area() };
        let Some((largest, _)) = splittable.max_by(|(_, a), (_, b)| size(a).total_cmp(&size(b))) else { break };
        let (left, right) = children.swap_remove(largest).split(balanced);
        children.push(left);
        children.push(right);
    }
    children
}

fn lanes(children: &[Range<'_>], value: impl Fn(&Range<'_>) -> f32, empty: f32) -> Vec4 {
    Vec4::from_array(std::array::from_fn(|lane| children.get(lane).map_or(empty, &value)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes;
    use proptest::prelude::*;

    fn brute_force(mesh: &Mesh, p: DVec3) -> f64 {
        let distance_sq = |t| closest_on_triangle(p, mesh.triangle_points(t)).1;
        (0..mesh.triangle_count()).map(distance_sq).fold(f64::INFINITY, f64::min)
    }

    fn soup(positions: Vec<[f32; 3]>, corners: &[usize]) -> Mesh {
        let id = |&corner: &usize| (corner % positions.len()) as u32;
        let triangles = corners.chunks_exact(3).map(|t| [id(&t[0]), id(&t[1]), id(&t[2])]).collect();
        Mesh::from_triangles(positions, triangles).expect("indices are taken modulo")
    }

    /// Every node is reached once, boxes hold what is below them and every triangle is in one leaf.
    fn assert_valid(mesh: &Mesh, bvh: &Bvh<'_>) {
        let mut seen = vec![0; bvh.slots.len()];
        let mut pending = vec![(0, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3])];
        let mut nodes = 0;
        while let Some((id, low, high)) = pending.pop() {
            let node = &bvh.nodes[id as usize];
            nodes += 1;
            for lane in (0..4).filter(|&lane| node.count[lane] != EMPTY) {
                let (child_low, child_high) = (node.low.map(|v| v[lane]), node.high.map(|v| v[lane]));
                assert!((0..3).all(|i| child_low[i] >= low[i] && child_high[i] <= high[i]));
                if node.count[lane] == 0 {
                    pending.push((id + node.link[lane], child_low, child_high));
                }
                for slot in node.link[lane]..node.link[lane] + u32::from(node.count[lane]) {
                    seen[slot as usize] += 1;
                    for p in mesh.triangle_points(bvh.slots[slot as usize].triangle as usize) {
                        let p = bvh.frame.local(p).to_array();
                        assert!((0..3).all(|i| p[i] >= f64::from(child_low[i]) && p[i] <= f64::from(child_high[i])));
                    }
                }
            }
        }
        assert_eq!(nodes, bvh.nodes.len());
        assert!(seen.iter().all(|&times| times == 1));
    }

    /// Points on a coarse lattice coincide, lie in line and in one plane; others are anywhere.
    fn position() -> impl Strategy<Value = [f32; 3]> {
        prop_oneof![prop::array::uniform3(-3i8..=3).prop_map(|p| p.map(f32::from)), prop::array::uniform3(-3.0f32..3.0),]
    }

    proptest! {
        #[test]
        fn finds_what_brute_force_finds(
            positions in prop::collection::vec(position(), 1..60),
            corners in prop::collection::vec(any::<usize>(), 3..600),
            queries in prop::collection::vec(position(), 1..20),
            offset in prop::sample::select(vec![0.0f32, 1e3, -1e7]),
            scale in prop::sample::select(vec![1.0f32, 1e-9, 1e9, 3e-39, 1e30]),
        ) {
            let place = |p: [f32; 3]| p.map(|x| (x + offset) * scale);
            let mesh = soup(positions.into_iter().map(place).collect(), &corners);
            let bvh = Bvh::new(&mesh);
            assert_valid(&mesh, &bvh);
            let mut searcher = bvh.searcher();
            for query in queries {
                let p = glam::Vec3::from(place(query)).as_dvec3();
                let found = searcher.closest(p).expect("there are triangles");
                prop_assert_eq!(found.distance_sq, brute_force(&mesh, p));
                let corners = mesh.triangle_points(found.triangle as usize);
                let error = (super::super::triangle::at(corners, found.barycentric) - found.point).length();
                prop_assert_eq!(error, 0.0);
                let gap = (found.point.distance(p) - found.distance_sq.sqrt()).abs();
                prop_assert!(gap <= 1e-12 * (p.length() + mesh.diagonal()), "{} {}", gap, p);
            }
        }
    }

    #[test]
    fn queries_far_away_are_exact() {
        let mesh = shapes::sphere(3);
        let bvh = Bvh::new(&mesh);
        for exponent in [2, 8, 18, 30] {
            let p = DVec3::new(0.3, -0.5, 0.8) * 10f64.powi(exponent);
            let found = bvh.closest(p).expect("there are triangles");
            assert_eq!(found.distance_sq, brute_force(&mesh, p), "{exponent}");
        }
    }

    #[test]
    fn large_meshes_are_built_in_parallel_the_same_way() {
        let mesh = shapes::torus(3.0, 1.0, 300, 100);
        let build = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be had");
            pool.install(|| {
                let bvh = Bvh::new(&mesh);
                assert_valid(&mesh, &bvh);
                (
                    bvh.nodes.iter().map(|n| (n.link, n.count)).collect::<Vec<_>>(),
                    bvh.triangles_in_space_order().collect::<Vec<_>>(),
                )
            })
        };
        assert_eq!(build(1), build(2));
        assert!(Bvh::new(&mesh).memory_bytes() < 40 * mesh.triangle_count());
    }

    #[test]
    fn what_is_not_finite_is_left_out() {
        let mut mesh = shapes::cube();
        mesh.positions[3] = [f32::NAN, 0.0, 0.0];
        mesh.positions[4][1] = f32::INFINITY;
        let bvh = Bvh::new(&mesh);
        assert!(bvh.triangles_in_space_order().len() < 12);
        assert!(bvh.closest(DVec3::splat(2.0)).is_some_and(|found| found.distance_sq.is_finite()));
        assert!(bvh.closest(DVec3::new(0.0, f64::NAN, 0.0)).is_none());
        assert!(Bvh::new(&Mesh::default()).closest(DVec3::ZERO).is_none());
    }

    #[test]
    fn coincident_triangles_make_a_shallow_tree() {
        let mesh = soup(vec![[1.0, 2.0, 3.0]], &vec![0; 3 * 100_000]);
        let bvh = Bvh::new(&mesh);
        assert_valid(&mesh, &bvh);
        assert_eq!(bvh.closest(DVec3::ZERO).map(|found| found.distance_sq), Some(14.0));
    }
}
