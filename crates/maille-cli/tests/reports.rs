//! Reports as their readers see them: whole pages, figures that agree with those of the other commands, nothing left behind
//! where something goes wrong.

mod support;

use maille::mesh::shapes;
use maille::simplify::{MetricKind, PlacementKind};
use maille_io::{Asset, WriteOptions};
use serde_json::Value;
use support::Folder;

/// A folder with a sphere of 2 048 triangles in it.
fn with_sphere(name: &str) -> Folder {
    let folder = Folder::new();
    let sphere = Asset::from_mesh("sphere", shapes::sphere(4));
    maille_io::write(&sphere, &folder.path(name), &WriteOptions::default()).expect("the sphere can be written");
    folder
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn text(folder: &Folder, name: &str) -> String {
    String::from_utf8(folder.bytes(name)).expect("it is UTF-8")
}

fn parsed(folder: &Folder, name: &str) -> Value {
    serde_json::from_str(&text(folder, name)).expect("it is JSON")
}

/// Every tag is closed in its turn, pictures and plots tell what they show, and nothing is asked of the network.
#[track_caller]
fn assert_is_whole(page: &str) {
    let mut open: Vec<&str> = Vec::new();
    let body = page.split_once("</style>").expect("there is a style sheet").1;
    let mut rest = body;
    open.extend(["html", "head"]);
    while let Some((_, from)) = rest.split_once('<') {
        let (tag, after) = from.split_once('>').expect("the tag ends");
        rest = after;
        let name = tag.trim_start_matches('/').split([' ', '\n', '/']).next().unwrap_or_default();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "closed out of turn: <{}>", &tag[..tag.len().min(80)]);
        } else if !tag.ends_with('/') && !["img", "input", "br", "meta"].contains(&name) {
            open.push(name);
        }
        if name == "img" {
            assert!(tag.contains("alt=\"") && tag.contains("src=\"data:image/png;base64,"), "a picture is not whole");
        }
        if tag.starts_with("svg") {
            assert!(tag.contains("aria-label=\""), "a plot tells nothing to who cannot see it");
        }
        if tag.starts_with("table") {
            assert!(rest.trim_start().starts_with("<caption>"), "a table has no caption");
        }
    }
    assert_eq!(open, [""; 0], "left open");
    assert!(!page.contains("http:") && !page.contains("https:") && !page.contains("<script"));
    assert!(page.starts_with("<!doctype html>") && page.contains("prefers-color-scheme: dark"));
}

#[test]
fn figures_of_a_report_agree_with_simplify_and_compare() {
    let folder = with_sphere("a.ply");
    let command = ["simplify", "a.ply", "-o", "b.ply", "--ratio", "25%", "--report", "r.html"];
    let told = folder.json(
        &[&command[..], &["--report-metrics", "qem,sem", "--report-levels", "10%", "--report-size", "32x32"]].concat(),
    );
    assert_eq!(folder.names(), ["a.ply", "b.ply", "r.html", "r.json"]);
    assert_eq!(told["files"], serde_json::json!(["b.ply", "r.html", "r.json"]));
    assert_eq!(told["report"], "r.html");

    let report = parsed(&folder, "r.json");
    for (key, value) in told.as_object().expect("it is an object") {
        assert_eq!(&report[key], value, "{key}");
    }
    let compared = folder.json(&["compare", "a.ply", "b.ply"]);
    for key in ["mean", "rms", "max", "normal_deg", "diagonal", "samples", "seed"] {
        let (own, other) = (number(&report["measured"][key]), number(&compared[key]));
        assert!((own - other).abs() <= 1e-6 * other.abs(), "{key}: {own} beside {other}");
    }
    assert_eq!(report["measured"]["figures_b"]["triangles"], told["triangles_out"]);

    let angles = |when: &str| {
        let bins = report["smallest_angles"][when].as_array().expect("there are bins");
        bins.iter().map(number).collect::<Vec<f64>>()
    };
    assert!((angles("before").iter().sum::<f64>() - 1.0).abs() < 1e-9);
    let bad = angles("after")[..2].iter().sum::<f64>();
    assert!(
        (bad - number(&compared["figures_b"]["bad_share"])).abs() < 1e-9,
        "two bins of 5 degrees are what is below 10"
    );

    let curves = report["curves"].as_array().expect("there are curves");
    let metrics: Vec<&str> = curves.iter().filter_map(|curve| curve["metric"].as_str()).collect();
    assert_eq!(metrics, ["qem-hybrid", "qem", "sem"], "the chosen one first");
    for curve in curves {
        let points = curve["points"].as_array().expect("there are points");
        let counts: Vec<u64> = points.iter().filter_map(|point| point["triangles"].as_u64()).collect();
        assert_eq!(counts, [205, 512].map(|n| if n == 205 { counts[0] } else { n }), "{curve}");
        assert!(counts[0] <= 205 && number(&points[0]["rms"]) > number(&points[1]["rms"]), "{curve}");
    }
    let at_result = &curves[0]["points"][1];
    assert_eq!((&at_result["rms"], &at_result["max"]), (&report["measured"]["rms"], &report["measured"]["max"]));

    let page = text(&folder, "r.html");
    assert_is_whole(&page);
    assert_eq!(page.matches("<img ").count(), 18, "before and after, three views, three looks");
    assert!(page.contains("maille simplify a.ply -o b.ply --ratio 25% --report r.html"), "the command is told");
}

#[test]
fn stages_are_timed_and_add_up() {
    let folder = with_sphere("a.ply");
    let told = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "25%", "--refit", "--threads", "1"]);
    let stages = told["stages"].as_array().expect("there are stages");
    let names: Vec<&str> = stages.iter().filter_map(|stage| stage["name"].as_str()).collect();
    assert_eq!(names, ["read", "simplify", "write"]);
    assert_eq!(stages[1]["seconds"], told["seconds"]);
    let parts = stages[1]["parts"].as_array().expect("there are parts");
    let of = |name: &str| parts.iter().find(|part| part["name"] == name).map(|part| number(&part["seconds"]));
    assert!(of("queue").is_some() && of("fitting").is_some(), "{told}");
    let sum: f64 = parts.iter().map(|part| number(&part["seconds"])).sum();
    assert!(sum > 0.0 && sum <= number(&told["seconds"]), "one mesh, one after the other: {told}");
}

#[test]
fn a_report_tells_of_every_mesh_and_attribute() {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", "a.glb", "--triangles", "2000"]);
    let command =
        ["simplify", "a.glb", "-o", "b.glb", "--ratio", "40%", "--report", "r.html", "--report-levels", "20%"];
    folder.done(&command);
    let report = parsed(&folder, "r.json");
    let parts = report["parts"].as_array().expect("there are parts");
    assert_eq!(Some(parts.len() as u64), report["meshes"].as_u64());
    let sum: u64 = parts.iter().filter_map(|part| part["triangles_out"].as_u64()).sum();
    assert_eq!(Some(sum), report["triangles_out"].as_u64());
    let attributes = report["attributes"].as_array().expect("there are attributes");
    let normal = attributes.iter().find(|a| a["attribute"] == "normal").expect("the character has normals");
    assert!(normal["unit"] == "degrees" && number(&normal["rms"]) > 0.0 && number(&normal["rms"]) < 60.0, "{normal}");
    assert_is_whole(&text(&folder, "r.html"));
}

#[test]
fn a_report_that_cannot_be_written_stops_all_before_it_begins() {
    let folder = with_sphere("a.ply");
    let before = folder.bytes("a.ply");
    let with = |report: &str| {
        let arguments = ["simplify", "a.ply", "--in-place", "--ratio", "0.5", "--report", report];
        arguments.map(str::to_owned)
    };
    let refused = |report: &str| {
        let arguments = with(report);
        folder.refused(&arguments.each_ref().map(String::as_str), report);
    };
    refused("absent/r.html");
    std::fs::create_dir(folder.path("taken.html")).expect("the name is free");
    refused("taken.html");
    let run = folder.run(&with("r.txt").each_ref().map(String::as_str));
    assert!(run.code == 2 && run.stderr.contains(".html"), "{}", run.stderr);
    folder.refused(&["bench", "metrics", "a.ply", "-o", "absent/r.md"], "r.md");
    folder.refused(&["bench", "metrics", "a.ply", "-o", "absent/r.html"], "r.html");
    folder.refused(&["bench", "metrics", "a.ply", "--levels", "5000"], "a.ply");
    assert!(folder.bytes("a.ply") == before);
    assert_eq!(folder.names(), ["a.ply", "taken.html"]);
}

#[test]
fn every_metric_is_compared() {
    let folder = with_sphere("a.ply");
    let command = ["bench", "metrics", "a.ply", "--levels", "50%,200", "--repeat", "1", "--samples", "20000"];
    let told = folder.json(&[&command[..], &["-o", "m.html", "--size", "32x32", "--threads", "1"]].concat());
    assert_eq!(folder.names(), ["a.ply", "m.html", "m.json"]);
    assert_eq!(parsed(&folder, "m.json"), told);
    let results = told["results"].as_array().expect("there are results");
    for (metric, _) in MetricKind::NAMES {
        for target in [1024, 200] {
            assert!(results.iter().any(|r| r["metric"] == metric && r["target"] == target), "{metric} to {target}");
        }
    }
    let default =
        MetricKind::NAMES.into_iter().find(|(_, kind)| *kind == MetricKind::default()).expect("it has a name").0;
    for (placement, _) in PlacementKind::NAMES {
        assert!(
            results.iter().any(|r| r["metric"] == default && r["placement"] == placement),
            "{default}, {placement}"
        );
    }
    assert_eq!(results.iter().filter(|r| r["fitted"] == true && r["metric"] == default).count(), 2);
    // all metrics, the default one at all placements, and fitted
    assert_eq!(results.len(), 2 * (MetricKind::NAMES.len() + PlacementKind::NAMES.len()));
    for pair in results.windows(2).filter(|pair| pair[0]["target"] == pair[1]["target"]) {
        assert!(number(&pair[0]["rms"]) <= number(&pair[1]["rms"]), "the nearest first");
    }
    for result in results {
        assert!(number(&result["seconds"]) > 0.0 && number(&result["mean"]) <= number(&result["rms"]), "{result}");
        assert!(
            number(&result["rms"]) <= number(&result["max"])
                && result["triangles"].as_u64() <= result["target"].as_u64()
        );
    }
    let page = text(&folder, "m.html");
    assert_is_whole(&page);
    assert!(MetricKind::NAMES.iter().all(|(metric, _)| page.contains(metric)));

    let own = &results.iter().find(|r| r["metric"] == "qem" && r["target"] == 200).expect("it is there");
    folder.done(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "200", "--metric", "qem"]);
    let compared = folder.json(&["compare", "a.ply", "b.ply", "--samples", "20000"]);
    assert!((number(&own["rms"]) / number(&compared["rms"]) - 1.0).abs() < 1e-6, "{own} beside {compared}");
}

#[test]
fn what_is_compared_can_be_chosen() {
    let folder = with_sphere("a.ply");
    let command = ["bench", "metrics", "a.ply", "--levels", "10%", "--repeat", "1", "--samples", "5000"];
    let chosen = ["--metrics", "qem,sem", "--placements", "subset,midpoint", "-o", "m.md"];
    let told = folder.json(&[&command[..], &chosen].concat());
    assert_eq!(told["results"].as_array().map(Vec::len), Some(4));
    let table = text(&folder, "m.md");
    assert_eq!(table.lines().filter(|line| line.starts_with("| `")).count(), 4);
    assert!(table.contains("| `qem` | `subset` |") && table.contains("millionths of the diagonal"), "{table}");
}

#[test]
fn a_geomorph_pops_less_than_a_cut_and_ends_at_the_next_level() {
    let folder = with_sphere("a.ply");
    let command = ["bench", "popping", "a.ply", "--levels", "5%,2%", "--views", "3", "--frames", "8"];
    let small = ["--size", "96x96", "-o", "p.html"];
    let told = folder.json(&[&command[..], &small, &["--threads", "1"]].concat());
    assert_eq!(folder.names(), ["a.ply", "p.html", "p.json"]);
    assert_eq!(parsed(&folder, "p.json"), told);
    let switches = told["switches"].as_array().expect("there are switches");
    assert_eq!(switches.len(), 2);
    for switch in switches {
        let [cut, morph] = ["cut_max", "morph_max"].map(|key| number(&switch[key]));
        assert!(cut > 0.01 && morph > 0.0 && morph < 0.5 * cut, "{switch}");
        assert!((number(&switch["ratio"]) - morph / cut).abs() < 1e-9);
        let steps: Vec<f64> = switch["steps"].as_array().expect("there are steps").iter().map(number).collect();
        assert_eq!((steps.len(), steps.iter().copied().fold(0.0, f64::max)), (9, morph));
        assert!(steps[8] < 1e-5, "the end of the geomorph is the next level: {}", steps[8]);
        let views = switch["views"].as_array().expect("there are views");
        assert_eq!((views.len(), switch["size"].as_array().map(Vec::len)), (3, Some(2)));
        // where a pixel of the screen is as large as the error allows
        let [error, distance] = ["error", "distance"].map(|key| number(&switch[key]));
        assert!((error / distance * 1080.0 / (2.0 * 30.0_f64.to_radians().tan()) - 1.0).abs() < 1e-9);
    }
    assert_eq!(number(&told["ratio"]), switches.iter().map(|s| number(&s["ratio"])).fold(0.0, f64::max));
    let page = text(&folder, "p.html");
    assert_is_whole(&page);
    assert_eq!(page.matches("<img ").count(), 10, "five pictures of each switch");
    assert_eq!(folder.json(&[&command[..], &small, &["--threads", "3"]].concat()), told);
}

#[test]
fn popping_of_the_morph_target_of_a_character() {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", "a.glb", "--triangles", "2000"]);
    let command = ["bench", "popping", "a.glb", "--levels", "30%", "--views", "2", "--frames", "4", "--size", "64x64"];
    let [exact, target] = [&[][..], &["--morph-target"]].map(|more| folder.json(&[&command[..], more].concat()));
    let end = |told: &Value| number(&told["switches"][0]["steps"][4]);
    assert!(end(&exact) < 1e-4, "levels in a pose are met exactly: {exact}");
    assert!(end(&target) > end(&exact), "joints and weights of the finer level stay: {target}");
    assert_eq!(target["morph_target"], true);
    folder.refused(&["bench", "popping", "a.glb", "-o", "absent/p.html"], "absent");
    for wrong in [["--pixels", "0"], ["--views", "0"], ["--frames", "0"], ["--size", "513x64"], ["-o", "p.txt"]] {
        assert_eq!(folder.run(&[&command[..3], &wrong].concat()).code, 2, "{wrong:?}");
    }
}

#[test]
fn errors_over_time_are_plotted() {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", "a.glb", "--triangles", "4000"]);
    folder.done(&["simplify", "a.glb", "-o", "b.glb", "--ratio", "20%"]);
    let command = ["compare", "a.glb", "b.glb", "--animated", "--samples", "2000", "--frames", "3"];
    let told = folder.json(&[&command[..], &["--report", "r.html"]].concat());
    assert_eq!(parsed(&folder, "r.json"), told);
    assert_eq!(told["files"], serde_json::json!(["r.html", "r.json"]));
    let page = text(&folder, "r.html");
    assert_is_whole(&page);
    assert_eq!(page.matches("<path class=\"line ").count(), 4, "three clips and the rest pose");
    for wanted in ["walk", "run", "idle", "at rest", "units of the file", "maille compare a.glb b.glb"] {
        assert!(page.contains(wanted), "{wanted} is missing");
    }
    folder.refused(&[&command[..], &["--report", "absent/r.html"]].concat(), "absent");
    let run = folder.run(&[&command[..], &["--report", "r.txt"]].concat());
    assert!(run.code == 2 && run.stderr.contains(".html"), "{}", run.stderr);
}

#[test]
fn broken_input_leaves_no_report() {
    let folder = Folder::new();
    folder.file("empty.obj", "v 0 0 0\n");
    folder.refused(&["bench", "metrics", "empty.obj", "-o", "m.html"], "empty.obj");
    folder.refused(&["bench", "popping", "empty.obj", "-o", "p.html"], "empty.obj");
    let command = ["simplify", "empty.obj", "-o", "b.ply", "--ratio", "0.5", "--report", "r.html"];
    folder.refused(&command, "empty.obj");
}
