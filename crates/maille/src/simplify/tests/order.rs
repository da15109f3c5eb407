//! The order of collapses against a loop without a queue: it evaluates every edge at every step.

use super::*;
use crate::topology::EdgeStar;
use crate::topology::collapse_mesh::{CollapseEffect, Marks};

/// The (kept, removed) vertices of each collapse, and where it went.
#[derive(Default)]
struct Recorder(Vec<([u32; 2], [f32; 3])>);

impl Observer for Recorder {
    fn on_collapse(&mut self, collapse: &Collapse<'_>) {
        self.0.push(([collapse.star.kept, collapse.star.removed], collapse.position));
    }
}

pub(super) fn faces_of(mesh: &Mesh) -> CollapseMesh {
    CollapseMesh::new(&mesh.positions, (0..mesh.triangle_count()).map(|t| mesh.triangle_vertices(t)))
}

fn with_queue<M: Metric>(mesh: &Mesh, mut metric: M, request: &Request<'_>) -> Recorder {
    let (mut faces, mut recorder) = (faces_of(mesh), Recorder::default());
    let options = to(0);
    let mut features = Features::new(&WedgeMerger::new(mesh.clone(), &options), &faces, &options);
    collapse_edges(&mut faces, &mut metric, &mut features, &mut recorder, request, Control::default()).unwrap();
    recorder
}

/// The cheapest edge of all at every step, edges of equal cost by their number; no limits but the features.
fn by_search<M: Metric>(mesh: &Mesh, mut metric: M, target: usize) -> Recorder {
    let (mut faces, mut recorder) = (faces_of(mesh), Recorder::default());
    let options = to(0);
    let mut features = Features::new(&WedgeMerger::new(mesh.clone(), &options), &faces, &options);
    let (mut marks, mut effect) = (Marks::new(faces.vertex_count()), CollapseEffect::default());
    metric.prepare(&faces, &features);
    while faces.live_face_count() > target {
        let candidates = (0..faces.edge_count() as u32).filter(|&e| faces.has_edge(e)).filter_map(|edge| {
            let ends = faces.ends(edge);
            let anchor = features.anchor(edge, ends).ok()?;
            let context = EdgeContext { ends, points: ends.map(|v| faces.point(v)), anchor };
            Some((edge, context, metric.evaluate(&faces, &features, &context)?))
        });
        let cheapest = candidates.min_by(|a, b| (a.2.cost as f32).total_cmp(&(b.2.cost as f32)).then(a.0.cmp(&b.0)));
        let Some((edge, context, candidate)) = cheapest else { break };
        let [kept, removed] = context.ends;
        let rings = [kept, removed].map(|v| faces.faces_around(v).collect::<Vec<_>>());
        let place = metric.refine(&faces, &context, &candidate, [&rings[0], &rings[1]]).expect("nothing is refused");
        let position = match place {
            p if p == context.points[0] => faces.position(kept),
            p if p == context.points[1] => faces.position(removed),
            p => faces.frame().leave(p),
        };
        recorder.0.push(([kept, removed], position));
        faces.collapse(&EdgeStar::new(edge, [kept, removed], &rings[0], &rings[1]), position, &mut marks, &mut effect);
        features.commit(kept, removed, &effect);
        metric.commit(&faces, kept, removed, &effect.neighbors, &features);
    }
    recorder
}

const NO_LIMITS: Limits = Limits {
    topology: TopologyPolicy::Free,
    parts_may_go: true,
    min_normal_cos: None,
    max_normal_deviation: None,
    valence: None,
    min_quality: None,
    no_self_intersections: false,
    max_error_sq: None,
};

fn meshes() -> [(&'static str, Mesh, usize); 3] {
    let mut torus = shapes::torus(2.0, 0.7, 16, 9);
    let mut sphere = shapes::sphere(2);
    for mesh in [&mut torus, &mut sphere] {
        (0..).zip(mesh.positions.as_flattened_mut()).for_each(|(i, x)| *x += 0.05 * noise(i));
    }
    [("torus", torus, 40), ("sphere", sphere, 20), ("terrain", terrain(9), 30)]
}

fn assert_same_order<M: Metric>(metric: impl Fn() -> M, what: &str) {
    for (name, mesh, target_faces) in meshes() {
        let request =
            Request { target_faces, order: Order::Exact, limits: NO_LIMITS, importance: &[], strictness: &[] };
        let (fast, slow) = (with_queue(&mesh, metric(), &request), by_search(&mesh, metric(), target_faces));
        for (i, (fast, slow)) in fast.0.iter().zip(&slow.0).enumerate() {
            assert_eq!(fast, slow, "{what}, {name}: collapse {i}");
        }
        assert_eq!(fast.0.len(), slow.0.len(), "{what}, {name}");
    }
}

#[test]
fn shortest_edges_come_in_order() {
    for (name, placement) in PlacementKind::NAMES {
        assert_same_order(|| ShortestEdge::new(placement), name);
    }
}

#[test]
fn quadric_costs_come_in_order() {
    for (name, placement) in PlacementKind::NAMES {
        for normalized in [false, true] {
            let options = QuadricOptions {
                face: FaceQuadric::Plane,
                line: 0.0,
                weight: QuadricWeight::Area,
                placement,
                constraint: Some(1.0),
                memory: QuadricMemory::Summed,
                normalized,
            };
            assert_same_order(|| QuadricMetric::new(options), name);
        }
    }
}
