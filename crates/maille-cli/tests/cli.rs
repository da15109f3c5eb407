//! The command as a user and a script see it: exit codes, messages, JSON, files.

mod support;

use maille::mesh::shapes;
use maille_io::{Asset, WriteOptions};
use support::Folder;

const COMMANDS: [&str; 13] = [
    "info",
    "convert",
    "sample",
    "simplify",
    "lod",
    "progressive",
    "compare",
    "bench",
    "repair",
    "render",
    "demo",
    "completions",
    "man",
];

/// A folder with a sphere of 2 048 triangles in it.
fn with_sphere(name: &str) -> Folder {
    let folder = Folder::new();
    let sphere = Asset::from_mesh("sphere", shapes::sphere(4));
    maille_io::write(&sphere, &folder.path(name), &WriteOptions::default()).expect("the sphere can be written");
    folder
}

#[test]
fn every_command_has_help_with_examples() {
    let folder = Folder::new();
    for command in COMMANDS {
        let help = folder.done(&[command, "--help"]).stdout;
        assert!(help.contains("Usage:") && help.contains("Example"), "{command}: {help}");
    }
    assert!(folder.done(&["--help"]).stdout.contains("Exit codes"));
    assert!(folder.done(&["--version"]).stdout.starts_with("maille "));
}

#[test]
fn wrong_usage_ends_with_2() {
    let folder = with_sphere("a.ply");
    for arguments in [
        &["polish"][..],
        &["simplify", "a.ply", "-o", "b.ply"],
        &["simplify", "a.ply", "-o", "b.ply", "--ratio", "2"],
        &["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.5", "--metric", "none"],
        &["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.5", "--triangles", "5"],
        &["simplify", "a.ply", "-o", "b.unknown", "--ratio", "0.5"],
        &["repair", "a.ply", "-o", "b.ply", "--only", "polish"],
        &["repair", "a.ply", "-o", "b.ply", "--only", "drop-degenerate", "--weld-tolerance", "1%"],
        &["render", "a.ply", "-o", "b.jpg"],
        &["bench"],
        &["bench", "metrics", "a.ply", "--metrics", "none"],
        &["bench", "metrics", "a.ply", "--levels", "200%"],
        &["bench", "metrics", "a.ply", "-o", "b.pdf"],
        &["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.5", "--report", "b.pdf"],
        &["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.5", "--report-metrics", "qem"],
        &["lod", "a.ply", "-o", "b.glb", "--levels", "10%,20%"],
        &["lod", "a.ply", "-o", "b.glb", "--levels", "none"],
        &["lod", "a.ply", "-o", "b.glb", "--poses", "clips"],
        &["lod", "a.ply", "-o", "b.unknown"],
        &["progressive", "a.ply", "-o", "b.glb"],
        &["progressive", "a.ply", "-o", "b.mpm", "--ratio", "10%"],
        &["progressive", "a.ply", "-o", "b.unknown", "--ratio", "10%"],
        &["simplify", "a.ply", "-o", "b.mpm", "--ratio", "0.5"],
        &["convert", "a.ply", "-o", "b.mpm"],
        &["info", "a.ply", "--threads", "0"],
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, 2, "{arguments:?}: {}", run.stderr);
        assert!(!run.stderr.is_empty() && run.stdout.is_empty());
    }
    assert_eq!(folder.names(), ["a.ply"]);
}

#[test]
fn simplify_keeps_the_contract() {
    let folder = with_sphere("a.ply");
    let report = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "25%", "--threads", "1"]);
    assert_eq!((&report["triangles_in"], &report["threads"]), (&2048.into(), &1.into()));
    assert_eq!((&report["triangles_out"], &report["stopped"]), (&512.into(), &"triangles".into()));
    assert!(report["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0));
    assert!(report["error"].as_f64().is_some_and(|error| error > 0.0 && error < 0.1));
    assert_eq!(report["peak_bytes"].is_u64(), cfg!(target_os = "linux"));
    for key in ["collapses", "refused", "metric", "placement", "preset", "warnings", "diagonal"] {
        assert!(!report[key].is_null(), "{key} is missing: {report}");
    }
    assert_eq!(folder.json(&["info", "b.ply"])["triangles"], 512);
}

#[test]
fn lod_makes_a_chain_in_one_file_or_several() {
    let folder = with_sphere("a.ply");
    let report = folder.json(&["lod", "a.ply", "-o", "b.glb", "--levels", "50%,200", "--geomorph"]);
    let triangles: Vec<u64> =
        report["levels"].as_array().into_iter().flatten().filter_map(|level| level["triangles"].as_u64()).collect();
    assert_eq!(triangles, [1024, 200]);
    assert_eq!(folder.json(&["info", "b.glb"])["instances"], 1);
    let report = folder.json(&["lod", "a.ply", "-o", "c.ply", "--levels", "25%"]);
    assert_eq!(report["files"].as_array().map(Vec::len), Some(2));
    assert_eq!(folder.json(&["info", "c_LOD0.ply"])["triangles"], 2048);
    assert_eq!(folder.json(&["info", "c_LOD1.ply"])["triangles"], 512);
    let report = folder.json(&["lod", "a.ply", "-o", "d.glb"]);
    assert_eq!(report["levels"].as_array().map(Vec::len), Some(4), "1024, 512, 256 and 128: {report}");
}

#[test]
fn lod_keeps_the_original() {
    let folder = with_sphere("a_LOD0.ply");
    let run = folder.run(&["lod", "a_LOD0.ply", "-o", "a.ply", "--levels", "25%"]);
    assert!(run.code == 2 && run.stderr.contains("this is an input"), "{}", run.stderr);
    assert_eq!(folder.names(), ["a_LOD0.ply"]);
}

#[test]
fn a_chain_is_recognised_and_may_be_edited() {
    let folder = with_sphere("a.ply");
    folder.done(&["lod", "a.ply", "-o", "b.glb", "--levels", "50%,10%", "--geomorph"]);
    let info = folder.json(&["info", "b.glb"]);
    assert_eq!(info["levels"], serde_json::json!([1024, 204]));
    folder.done(&["convert", "b.glb", "-o", "level.glb", "--level", "2"]);
    assert_eq!(folder.json(&["info", "level.glb"])["triangles"], 204);
    let run = folder.run(&["convert", "b.glb", "-o", "none.glb", "--level", "3"]);
    assert!(run.code == 2 && run.stderr.contains("there are 2"), "{}", run.stderr);
    // the levels stay as they are, but for one
    folder.done(&["simplify", "level.glb", "-o", "edited.glb", "--ratio", "50%"]);
    let report = folder.json(&["lod", "b.glb", "-o", "c.glb", "--edited", "2=edited.glb", "--geomorph=both"]);
    let triangles = |report: &serde_json::Value| -> Vec<serde_json::Value> {
        report["levels"].as_array().into_iter().flatten().map(|level| level["triangles"].clone()).collect()
    };
    assert_eq!(triangles(&report), [1024, 102]);
    let again = folder.json(&["lod", "c.glb", "-o", "again.glb", "--pixels", "4"]);
    let errors = |report: &serde_json::Value| [0, 1].map(|k| report["levels"][k]["error"].clone());
    assert_eq!(errors(&again), errors(&report), "errors are kept, whatever they look like");
    folder.done(&["convert", "c.glb", "-o", "one.ply"]);
    assert_eq!(folder.json(&["info", "one.ply"])["triangles"], 2048);
    let run = folder.json(&["lod", "a.ply", "-o", "f.glb", "--levels", "100%,1"]);
    assert_eq!(run["warnings"].as_array().map(Vec::len), Some(2), "{run}");
    assert_eq!(folder.json(&["info", "c.glb"])["levels"], serde_json::json!([1024, 102]));
    // or are made anew
    let report = folder.json(&["lod", "c.glb", "-o", "d.glb", "--levels", "error=1%"]);
    assert!(report["levels"][0]["error"].as_f64().is_some_and(|error| error > 0.0 && error <= 0.0347));
    // a simplified file has none
    folder.done(&["simplify", "c.glb", "-o", "e.glb", "--ratio", "50%"]);
    assert_eq!(folder.json(&["info", "e.glb"])["levels"], serde_json::json!([]));
    assert_eq!(folder.json(&["info", "e.glb"])["triangles"], 1024);
    let run = folder.run(&["lod", "b.glb", "-o", "f.glb", "--edited", "7=edited.glb"]);
    assert!(run.code == 2 && run.stderr.contains("there are 2"), "{}", run.stderr);
}

#[test]
fn masks_are_images_or_attributes() {
    let folder = Folder::new();
    folder.done(&["sample", "vase", "-o", "a.glb", "--triangles", "2000"]);
    // black on the left, white on the right
    let image = image::GrayImage::from_fn(8, 2, |x, _| image::Luma([if x < 4 { 0 } else { 255 }]));
    image.save(folder.path("mask.png")).expect("the folder can be written to");
    for option in ["--importance", "--lock", "--region"] {
        folder.done(&["simplify", "a.glb", "-o", "b.glb", "--ratio", "0.6", option, "mask.png"]);
        folder.done(&["lod", "a.glb", "-o", "c.glb", "--levels", "60%", option, "mask.png"]);
    }
    let run = folder.refused(&["simplify", "a.glb", "-o", "d.glb", "--ratio", "0.5", "--lock", "none.png"], "none.png");
    assert!(run.stderr.contains("mask"), "{}", run.stderr);
    folder.done(&["convert", "a.glb", "-o", "a.stl"]);
    folder.refused(&["simplify", "a.stl", "-o", "d.stl", "--ratio", "0.5", "--lock", "mask.png"], "a.stl");
}

#[test]
fn progressive_makes_a_file_and_cuts_levels_out_of_it() {
    let folder = with_sphere("a.ply");
    let made = folder.json(&["progressive", "a.ply", "-o", "b.mpm"]);
    let facts = &made["progressive"];
    assert_eq!((&made["triangles_in"], &facts["triangles_finest"]), (&2048.into(), &2048.into()));
    assert!(facts["collapses"].as_u64() > Some(900) && facts["bytes_per_collapse"].as_f64() < Some(70.0), "{made}");
    let cut = folder.json(&["progressive", "b.mpm", "-o", "c.glb", "--triangles", "300"]);
    assert_eq!((&cut["triangles_in"], &cut["triangles_out"]), (&2048.into(), &300.into()));
    assert!(cut["error"].as_f64() > Some(0.0));
    assert_eq!(folder.json(&["info", "c.glb"])["triangles"], 300);
    folder.done(&["progressive", "b.mpm", "-o", "d.ply", "--ratio", "25%"]);
    assert_eq!(folder.json(&["info", "d.ply"])["triangles"], 512);
    assert_eq!(folder.json(&["info", "b.mpm"])["progressive"], *facts);
    assert!(folder.done(&["info", "b.mpm"]).stdout.contains("bytes each"));
    // to all other commands it is its finest level
    folder.done(&["convert", "b.mpm", "-o", "e.ply"]);
    let distance = folder.json(&["compare", "a.ply", "e.ply", "--samples", "1000"]);
    assert!(distance["max"].as_f64() < Some(1e-6), "{distance}");
    let threads = folder.json(&["progressive", "a.ply", "-o", "f.mpm", "--threads", "1"]);
    assert_eq!(threads["progressive"], *facts);
    assert_eq!(folder.bytes("f.mpm"), folder.bytes("b.mpm"));
}

#[test]
fn progressive_refuses_what_makes_no_sense() {
    let folder = with_sphere("a.ply");
    folder.done(&["progressive", "a.ply", "-o", "b.mpm"]);
    folder.refused(&["progressive", "b.mpm", "-o", "c.mpm"], "b.mpm");
    let run = folder.refused(&["progressive", "a.ply", "-o", "c.glb", "--ratio", "10%"], "a.ply");
    assert!(run.stderr.contains("maille simplify"), "{}", run.stderr);
    let mut damaged = folder.bytes("b.mpm");
    damaged[500] ^= 1;
    folder.file("d.mpm", damaged);
    for arguments in [&["info", "d.mpm"][..], &["progressive", "d.mpm", "-o", "c.glb", "--ratio", "10%"]] {
        let run = folder.refused(arguments, "d.mpm");
        assert!(
            run.stderr.contains("byte 12: the checksum") && run.stderr.contains("fetch it again"),
            "{}",
            run.stderr
        );
    }
}

#[test]
fn lod_tells_which_clips_there_are() {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", "c.glb", "--triangles", "2000"]);
    let run = folder.run(&["lod", "c.glb", "-o", "d.glb", "--poses", "fly@1"]);
    assert!(run.code == 2 && run.stderr.contains("walk"), "{}", run.stderr);
    folder.done(&["lod", "c.glb", "-o", "d.glb", "--poses", "walk@0.25", "--levels", "20%"]);
}

#[test]
fn clustering_is_a_method_and_the_fastest_preset() {
    let folder = with_sphere("a.ply");
    for (name, _) in maille::cluster::ClusterMethod::NAMES {
        let report = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "25%", "--method", name]);
        let left = report["triangles_out"].as_u64().unwrap_or(u64::MAX);
        assert!((400..=512).contains(&left), "{name}: {left}");
        assert_eq!((&report["method"], &report["stopped"]), (&name.into(), &"triangles".into()));
        assert!(report["metric"].is_null() && report["error"].as_f64().is_some_and(|error| error > 0.0 && error < 0.5));
        assert_eq!(folder.json(&["info", "b.ply"])["triangles"], left);
    }
    let fastest = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "500", "--preset", "fastest"]);
    assert_eq!((&fastest["method"], &fastest["preset"]), (&"quadric-clustering".into(), &"fastest".into()));
    let text = folder.done(&["simplify", "a.ply", "-o", "b.ply", "--max-error", "10%", "--preset", "fastest"]).stdout;
    assert!(text.contains("larger cells") && text.contains("as far as a vertex moved"), "{text}");
    let first = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "100", "--cluster-first", "4"]);
    assert_eq!((&first["triangles_in"], &first["triangles_out"]), (&2048.into(), &100.into()));
    assert_eq!(first["method"], "collapse");
    for option in [["--metric", "qem"], ["--boundary", "lock"], ["--cluster-first", "4"], ["--max-normal-turn", "off"]]
    {
        let command = [&["simplify", "a.ply", "-o", "c.ply", "--ratio", "0.5", "--preset", "fastest"], &option[..]];
        let run = folder.run(&command.concat());
        assert_eq!(run.code, 2);
        assert!(run.stderr.contains(option[0]) && run.stderr.contains("edge collapse"), "{}", run.stderr);
    }
}

#[test]
fn every_metric_placement_and_preset_is_accepted() {
    let folder = with_sphere("a.ply");
    let presets = ["fast", "balanced", "best", "aggressive"];
    let mut choices: Vec<(&str, &str)> = presets.map(|name| ("--preset", name)).to_vec();
    choices.extend(maille::simplify::MetricKind::NAMES.map(|(name, _)| ("--metric", name)));
    choices.extend(maille::simplify::PlacementKind::NAMES.map(|(name, _)| ("--placement", name)));
    choices.extend(["uniform", "area", "area-squared", "angle"].map(|name| ("--weights", name)));
    choices.extend(maille::simplify::QuadricMemory::NAMES.map(|(name, _)| ("--memory", name)));
    choices.extend([("--silhouette-weight", "2"), ("--max-normal-deviation", "60")]);
    for (option, name) in choices {
        let report = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "300", option, name]);
        let left = report["triangles_out"].as_u64().unwrap_or(u64::MAX);
        assert!((290..=300).contains(&left), "{option} {name}: {left}");
    }
}

#[test]
fn largest_error_may_be_given_in_percent_of_the_diagonal() {
    let folder = with_sphere("a.ply");
    let report = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--max-error", "0.5%"]);
    assert_eq!(report["stopped"], "max_error");
    let (error, diagonal) = (report["error"].as_f64(), report["diagonal"].as_f64());
    assert!(error <= diagonal.map(|diagonal| 0.005 * diagonal), "{report}");
    assert!(report["triangles_out"].as_u64().is_some_and(|left| left > 4 && left < 2048));
}

#[test]
fn compare_keeps_the_contract() {
    let folder = with_sphere("a.ply");
    folder.done(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.1"]);
    let figures = folder.json(&["compare", "a.ply", "b.ply", "--samples", "20000", "--heatmap", "heat.ply"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    for key in ["mean", "rms", "max"] {
        let sides = number(&figures["forward"][key]).max(number(&figures["backward"][key]));
        assert_eq!(number(&figures[key]), sides, "{key} is the larger of both directions");
        assert!(sides > 0.0 && sides < 0.2);
    }
    assert!((number(&figures["diagonal"]) - 12_f64.sqrt()).abs() < 1e-4);
    assert!(number(&figures["normal_deg"]) > 0.0);
    let heat = folder.json(&["info", "heat.ply"]);
    let attributes = heat["meshes"][0]["attributes"].as_array().map_or(0, Vec::len);
    assert!(heat["triangles"] == 2048 && attributes >= 2, "{heat}");
    let same = folder.json(&["compare", "a.ply", "a.ply", "--samples", "5000"]);
    assert!(number(&same["max"]) < 1e-9);
}

#[test]
fn an_exact_comparison_proves_the_maximum() {
    let folder = with_sphere("a.ply");
    folder.done(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.1"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    let sampled = folder.json(&["compare", "a.ply", "b.ply", "--samples", "20000"]);
    assert_eq!(sampled["exact"], false);
    let exact = folder.json(&["compare", "a.ply", "b.ply", "--samples", "20000", "--exact"]);
    assert_eq!((&exact["exact"], &exact["converged"]), (&true.into(), &true.into()));
    assert_eq!((&exact["mean"], &exact["rms"]), (&sampled["mean"], &sampled["rms"]));
    assert_eq!(exact["max"], exact["max_upper"]);
    for key in ["forward", "backward"] {
        let (side, found) = (&exact[key], &sampled[key]);
        assert!(number(&side["max"]) >= number(&found["max"]), "{key}");
        assert!(number(&side["max_lower"]) >= 0.9 * number(&found["max"]), "{key}");
        assert_eq!(side["max"], side["max_upper"]);
    }
    assert!((number(&exact["tolerance"]) / number(&exact["diagonal"]) - 1e-6).abs() < 1e-9);
    assert!(number(&exact["max_upper"]) - number(&exact["max_lower"]) <= number(&exact["tolerance"]));
    let wide = folder.json(&["compare", "a.ply", "b.ply", "--samples", "9", "--exact", "--tolerance", "0.01"]);
    assert!((number(&wide["tolerance"]) - 0.01).abs() < 1e-12);
    assert!(number(&wide["max_lower"]) <= number(&exact["max_upper"]));
    let text = folder.done(&["compare", "a.ply", "b.ply", "--samples", "9", "--exact"]).stdout;
    assert!(text.contains("maximum, proven") && text.contains("proof"), "{text}");
    assert_eq!(folder.run(&["compare", "a.ply", "b.ply", "--tolerance", "1%"]).code, 2);
}

/// A folder with the sample character in it.
fn with_character(name: &str) -> Folder {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", name, "--triangles", "4000"]);
    folder
}

#[test]
fn an_animated_comparison_goes_over_all_clips() {
    let folder = with_character("a.glb");
    folder.done(&["simplify", "a.glb", "-o", "b.glb", "--ratio", "20%"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    let command = ["compare", "a.glb", "b.glb", "--animated", "--samples", "4000"];
    let told = folder.json(&[&command[..], &["--frames", "3"]].concat());
    let clips = told["clips"].as_array().expect("there are clips");
    assert_eq!(clips.iter().filter_map(|clip| clip["name"].as_str()).collect::<Vec<_>>(), ["walk", "run", "idle"]);
    let mut all = Vec::new();
    for clip in clips {
        let frames = clip["frames"].as_array().expect("there are frames");
        let of = |key: &str| frames.iter().map(|frame| number(&frame[key])).collect::<Vec<f64>>();
        let third = number(&clip["end"]) / 3.0;
        assert!(of("seconds").iter().zip([0.5, 1.5, 2.5]).all(|(at, part)| (at - part * third).abs() < 1e-6), "{clip}");
        let mean_square = of("rms").iter().map(|rms| rms * rms).sum::<f64>() / 3.0;
        assert!((number(&clip["rms"]) - mean_square.sqrt()).abs() < 1e-12);
        assert_eq!(number(&clip["max"]), of("max").into_iter().fold(0.0, f64::max));
        all.extend(frames);
    }
    let largest = |key: &str| all.iter().map(|frame| number(&frame[key])).fold(0.0, f64::max);
    assert_eq!((number(&told["worst"]["rms"]), number(&told["max"])), (largest("rms"), largest("max")));
    assert!(all.iter().any(|frame| frame["seconds"] == told["worst"]["seconds"]), "{told}");
    for pose in all.iter().copied().chain([&told["rest"]]) {
        assert!(number(&pose["rms"]) > 0.0 && number(&pose["max"]) < 0.2, "{pose}");
        let share = number(&pose["rms"]) / number(&pose["diagonal"]);
        assert!((number(&pose["rms_of_diagonal"]) - share).abs() < 1e-12);
    }
    let at_rest = folder.json(&["compare", "a.glb", "b.glb", "--samples", "4000"]);
    assert!((number(&told["rest"]["rms"]) / number(&at_rest["rms"]) - 1.0).abs() < 1e-3, "{at_rest}");

    let text = folder.done(&command).stdout;
    for wanted in ["(at rest)", "walk", "(all frames)", "worst frame", " s: RMS ", "4 000 points"] {
        assert!(text.contains(wanted), "{wanted} is missing: {text}");
    }
    let line = |name: &str| text.lines().find(|line| line.starts_with(name)).unwrap_or_default().to_owned();
    assert!(line("walk").contains(" 8 ") && line("(all").contains(" 24 "), "24 frames over three clips: {text}");

    let mut one = folder.json(&[&command[..], &["--frames", "2", "--threads", "1"]].concat());
    one["threads"] = 3.into();
    assert_eq!(one, folder.json(&[&command[..], &["--frames", "2", "--threads", "3"]].concat()));
}

#[test]
fn an_animated_comparison_sees_what_the_rest_pose_hides() {
    let folder = with_character("a.glb");
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    let command = ["compare", "a.glb", "b.glb", "--animated", "--samples", "2000", "--frames", "2"];
    std::fs::copy(folder.path("a.glb"), folder.path("b.glb")).expect("the file can be copied");
    let same = folder.json(&command);
    assert!(number(&same["max"]) < 1e-9 && number(&same["rest"]["max"]) < 1e-9, "{same}");
    // all hangs on one joint: nothing changes at rest
    let mut stiff = maille_io::read(&folder.path("a.glb"), &maille_io::ReadOptions::default()).expect("it can be read");
    for attribute in &mut stiff.meshes[0].mesh.wedge_attributes {
        if let (maille::Semantic::Joints(_), maille::mesh::Values::U32(joints)) =
            (&attribute.semantic, &mut attribute.values)
        {
            joints.fill(0);
        }
    }
    maille_io::write(&stiff, &folder.path("b.glb"), &WriteOptions::default()).expect("it can be written");
    let told = folder.json(&command);
    assert!(number(&told["rest"]["max"]) < 1e-5, "{}", told["rest"]);
    assert!(told["clips"].as_array().is_some_and(|clips| clips.iter().all(|clip| number(&clip["rms"]) > 0.01)));
    // arms and legs go a long way
    assert!(number(&told["farthest"]["max"]) > 0.2 && told["farthest"]["clip"] == "run", "{}", told["farthest"]);
}

#[test]
fn clips_that_are_missing_or_do_not_match_are_told() {
    let folder = with_character("a.glb");
    folder.done(&["sample", "vase", "-o", "still.glb", "--triangles", "1000"]);
    folder.done(&["convert", "a.glb", "-o", "a.ply"]);
    let run = folder.refused(&["compare", "a.glb", "still.glb", "--animated"], "still.glb");
    assert!(run.stderr.contains("no animation clips") && run.stderr.contains("without --animated"), "{}", run.stderr);
    let run = folder.refused(&["compare", "a.ply", "a.glb", "--animated", "--report", "r.html"], "a.ply");
    assert!(run.stderr.contains("only glTF and GLB"), "{}", run.stderr);

    let mut character = maille::samples::character(4000);
    let write = |character: &maille::samples::Character| {
        let asset = Asset::from_character("b", character);
        maille_io::write(&asset, &folder.path("b.glb"), &WriteOptions::default()).expect("it can be written");
    };
    character.clips.truncate(2);
    character.clips[0].name = "stroll".to_owned();
    write(&character);
    let command = ["compare", "a.glb", "b.glb", "--animated", "--samples", "1000", "--frames", "1"];
    let run = folder.done(&command);
    assert!(run.stderr.contains("'walk' of A is compared with 'stroll' of B"), "{}", run.stderr);
    assert!(run.stderr.contains("only A has the clips 'idle'"), "{}", run.stderr);
    for channel in &mut character.clips[1].channels {
        channel.times.iter_mut().for_each(|time| *time *= 2.0);
    }
    write(&character);
    let run = folder.done(&command);
    assert!(run.stderr.contains("'run' goes from 0 to 0.7 s in A and 0 to 1.4 s in B"), "{}", run.stderr);
    character.clips.remove(0);
    character.clips[0].name = "sprint".to_owned();
    write(&character);
    let run = folder.refused(&command, "a.glb");
    assert!(run.stderr.contains("'walk', 'run', 'idle'") && run.stderr.contains("'sprint'"), "{}", run.stderr);
    for wrong in [&["--frames", "3"][..], &["--report", "r.html"], &["--animated", "--exact"]] {
        assert_eq!(folder.run(&[&["compare", "a.glb", "a.glb"][..], wrong].concat()).code, 2, "{wrong:?}");
    }
}

#[test]
fn a_certified_error_holds_when_it_is_measured() {
    let folder = Folder::new();
    folder.done(&["sample", "statue", "-o", "a.ply", "--triangles", "20000"]);
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::NAN);
    for more in [&[][..], &["--refit"], &["--triangles", "15000"]] {
        let line = [&["simplify", "a.ply", "-o", "b.ply", "--max-error", "0.2%", "--certify"], more].concat();
        let report = folder.json(&line);
        let most = 0.002 * number(&report["diagonal"]);
        let proven = number(&report["max_error_proven"]);
        assert!(proven > 0.0 && proven <= most, "{report}");
        assert_eq!(report["refit"].as_array().map_or(0, Vec::len), usize::from(more.contains(&"--refit")));
        let exact = folder.json(&["compare", "a.ply", "b.ply", "--samples", "1000", "--exact"]);
        assert!(number(&exact["max_lower"]) <= proven && number(&exact["max_upper"]) <= 1.0001 * most, "{exact}");
        if more.contains(&"--triangles") {
            assert_eq!((&report["triangles_out"], &report["stopped"]), (&15000.into(), &"triangles".into()));
        } else {
            assert!(number(&exact["max_upper"]) > 0.8 * most && number(&report["triangles_out"]) < 10000.0);
        }
    }
    let text = folder.done(&["simplify", "a.ply", "-o", "b.ply", "--max-error", "1%", "--certify"]).stdout;
    assert!(text.contains("proven") && text.contains("no point of either surface is farther"), "{text}");
    let plain = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--max-error", "1%"]);
    assert!(plain["max_error_proven"].is_null());
    assert_eq!(folder.run(&["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.5", "--certify"]).code, 2);
}

#[test]
fn self_intersections_can_be_ruled_out() {
    let folder = with_sphere("a.ply");
    let line = ["simplify", "a.ply", "-o", "b.ply", "--ratio", "0.1", "--no-self-intersections"];
    let report = folder.json(&line);
    assert!(report["triangles_out"] == 204 && report["refused"]["self_intersections"].is_u64(), "{report}");
    let best = folder.json(&[&line[..], &["--preset", "best"]].concat());
    assert_eq!(best["refit"].as_array().map(Vec::len), Some(0));
    assert_eq!(folder.run(&[&line[..], &["--refit"]].concat()).code, 2);
}

#[test]
fn threads_do_not_change_what_is_written() {
    let folder = with_sphere("a.glb");
    for threads in ["1", "2"] {
        let name = |stem: &str, extension: &str| format!("{stem}{threads}.{extension}");
        folder.done(&["simplify", "a.glb", "-o", &name("s", "glb"), "--ratio", "0.2", "--threads", threads]);
        folder.done(&["repair", "a.glb", "-o", &name("r", "ply"), "--all", "--threads", threads]);
        folder.done(&["render", "a.glb", "-o", &name("p", "png"), "--size", "64x64", "--threads", threads]);
        let heat = name("h", "ply");
        folder.done(&["compare", "a.glb", "s1.glb", "--heatmap", &heat, "--samples", "999", "--threads", threads]);
    }
    for (one, two) in [("s1.glb", "s2.glb"), ("r1.ply", "r2.ply"), ("p1.png", "p2.png"), ("h1.ply", "h2.ply")] {
        assert!(folder.bytes(one) == folder.bytes(two), "{one} and {two} differ");
    }
}

#[test]
fn what_cannot_be_read_is_refused_and_named() {
    let folder = Folder::new();
    folder.file("empty.ply", "");
    folder.file("noise.glb", [7_u8; 900]);
    folder.file("cut.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n");
    folder.file("points.obj", "v 0 0 0\nv 1 0 0\n");
    for file in ["empty.ply", "noise.glb", "cut.off", "points.obj", "absent.stl"] {
        folder.refused(&["info", file], file);
        folder.refused(&["convert", file, "-o", "out.ply"], file);
        folder.refused(&["simplify", file, "-o", "out.glb", "--ratio", "0.5"], file);
        folder.refused(&["repair", file, "-o", "out.stl"], file);
        folder.refused(&["compare", file, file], file);
        folder.refused(&["render", file, "-o", "out.png"], file);
    }
}

#[test]
fn what_cannot_be_written_is_refused_and_named() {
    let folder = with_sphere("a.ply");
    folder.refused(&["convert", "a.ply", "-o", "absent/out.glb"], "out.glb");
    folder.refused(&["render", "a.ply", "-o", "absent/out.png", "--size", "32x32"], "out.png");
    std::fs::create_dir(folder.path("taken.ply")).expect("the name is free");
    let run = folder.refused(&["simplify", "a.ply", "-o", "taken.ply", "--ratio", "0.5"], "taken.ply");
    assert!(run.stderr.contains("name a file in it"), "{}", run.stderr);
    for command in ["demo", "man"] {
        let run = folder.refused(&[command, "-o", "a.ply"], "a.ply");
        assert!(run.stderr.contains("name another"), "{}", run.stderr);
    }
}

#[test]
fn a_file_replaces_itself_only_when_asked_to() {
    let folder = with_sphere("a.ply");
    let before = folder.bytes("a.ply");
    for arguments in [
        &["simplify", "a.ply", "-o", "./a.ply", "--triangles", "100"][..],
        &["repair", "a.ply", "-o", "a.ply"],
        &["convert", "a.ply", "-o", "a.ply", "--text"],
        &["compare", "b.ply", "a.ply", "--heatmap", "a.ply"],
        &["convert", "a.ply", "-o", "b.ply", "--in-place"],
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, 2, "{arguments:?}: {}", run.stderr);
        assert!(folder.bytes("a.ply") == before, "{arguments:?}");
    }
    assert!(folder.run(&["repair", "a.ply", "-o", "a.ply"]).stderr.contains("--in-place"));
    let run = folder.done(&["simplify", "a.ply", "--in-place", "--triangles", "100"]);
    assert!(!run.stdout.contains("maille compare"), "a file is not compared with itself: {}", run.stdout);
    assert_eq!(folder.json(&["info", "a.ply"])["triangles"], 100);
    folder.done(&["convert", "a.ply", "--in-place", "--text"]);
    folder.done(&["repair", "a.ply", "--in-place"]);
    assert_eq!(folder.names(), ["a.ply"]);
}

#[test]
fn quiet_prints_nothing_but_what_json_asks_for() {
    let folder = with_sphere("a.glb");
    for arguments in [
        &["info", "a.glb"][..],
        &["simplify", "a.glb", "-o", "b.stl", "--ratio", "0.5"],
        &["convert", "a.glb", "-o", "c.gltf"],
        &["repair", "a.glb", "-o", "d.ply"],
        &["compare", "a.glb", "b.stl", "--samples", "999"],
        &["render", "a.glb", "-o", "e.png", "--size", "32x32"],
        &["sample", "vase", "-o", "f.ply", "--triangles", "1"],
    ] {
        let run = folder.done(&[arguments, &["-q"]].concat());
        assert_eq!((run.stdout.as_str(), run.stderr.as_str()), ("", ""), "{arguments:?}");
        let run = folder.done(&[arguments, &["-q", "--json"]].concat());
        assert!(run.stdout.starts_with('{') && run.stderr.is_empty(), "{arguments:?}: {}", run.stderr);
    }
    assert!(!folder.run(&["info", "absent.ply", "-q"]).stderr.is_empty());
}

#[test]
fn every_file_written_is_told() {
    let folder = with_sphere("a.ply");
    let files = |arguments: &[&str]| folder.json(arguments)["files"].clone();
    assert_eq!(files(&["convert", "a.ply", "-o", "b.gltf"]), serde_json::json!(["b.gltf", "b.bin"]));
    assert_eq!(files(&["repair", "a.ply", "-o", "c.gltf"]), serde_json::json!(["c.gltf", "c.bin"]));
    assert_eq!(files(&["sample", "vase", "-o", "d.ply", "--triangles", "3000"]), serde_json::json!(["d.ply"]));
    let run = folder.done(&["simplify", "a.ply", "-o", "b.gltf", "--ratio", "0.5"]);
    assert!(run.stdout.contains("b.gltf (") && run.stdout.contains("b.bin ("), "{}", run.stdout);
}

#[test]
fn what_a_format_cannot_hold_is_told() {
    let folder = Folder::new();
    folder.done(&["sample", "character", "-o", "a.glb", "--triangles", "2000"]);
    let run = folder.done(&["convert", "a.glb", "-o", "b.ply"]);
    for part in ["b.ply: left out: 1 skin (kept by .glb and .gltf)", "animations", "material"] {
        assert!(run.stderr.contains(part), "{part}: {}", run.stderr);
    }
    let report = folder.json(&["simplify", "a.glb", "-o", "b.stl", "--ratio", "0.5"]);
    let warnings = report["warnings"].as_array().map_or(0, Vec::len);
    assert_eq!(warnings, 4, "{report}");
    let report = folder.json(&["simplify", "a.glb", "-o", "b.glb", "--ratio", "0.5"]);
    assert_eq!(report["warnings"], serde_json::json!([]));
}

#[test]
fn info_measures_where_meshes_stand() {
    let folder = Folder::new();
    let mut cube = Asset::from_mesh("cube", shapes::cube());
    cube.instances[0].transform = glam::DMat4::from_scale(glam::DVec3::splat(10.0));
    cube.instances.push(cube.instances[0].clone());
    maille_io::write(&cube, &folder.path("a.glb"), &WriteOptions::default()).expect("the cubes can be written");
    let info = folder.json(&["info", "a.glb"]);
    let own = |key: &str| info["meshes"][0][key].as_f64().unwrap_or(f64::NAN);
    let world = |key: &str| info[key].as_f64().unwrap_or(f64::NAN);
    assert!((world("area") / own("area") - 200.0).abs() < 1e-6, "{info}");
    assert!((world("volume") / own("volume") - 2000.0).abs() < 1e-6, "{info}");
    let text = folder.done(&["info", "a.glb"]).stdout;
    assert!(text.contains("in its units"), "{text}");
    folder.done(&["convert", "a.glb", "-o", "a.ply"]);
    assert_eq!(folder.json(&["info", "a.ply"])["area"], info["area"]);
}

#[test]
fn info_tells_what_reading_left_out() {
    let folder = Folder::new();
    folder.file("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 1\nf 1 2 3\nf 1 2 4\n");
    let run = folder.done(&["info", "a.obj"]);
    assert!(run.stdout.contains("1 vertices have coordinates that are not finite"), "{}", run.stdout);
    assert_eq!(run.stderr, "");
}

#[test]
fn repair_tells_what_the_file_still_has_when_it_is_read() {
    let folder = Folder::new();
    // two tetrahedra that touch at a corner
    folder.file(
        "touching.obj",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv -1 0 0\nv 0 -1 0\nv 0 0 -1\n\
         f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\nf 1 5 6\nf 1 7 5\nf 1 6 7\nf 5 7 6\n",
    );
    let kept = folder.json(&["repair", "touching.obj", "-o", "a.obj"]);
    assert_eq!((&kept["changes"]["vertices_added"], &kept["remaining"]), (&1.into(), &serde_json::json!({})));
    let lost = folder.json(&["repair", "touching.obj", "-o", "a.glb"]);
    assert_eq!(lost["remaining"]["non-manifold vertices"], 1, "{lost}");
    assert!(lost["warnings"][0].as_str().is_some_and(|warning| warning.contains("join vertices")), "{lost}");
}

#[test]
fn options_that_a_format_cannot_follow_are_wrong_usage() {
    let folder = with_sphere("a.ply");
    let wrong = |arguments: &[&str], remedy: &str| {
        let run = folder.run(arguments);
        assert!(run.code == 2 && run.stderr.contains(remedy), "{arguments:?}: {}", run.stderr);
    };
    wrong(&["convert", "a.ply", "-o", "b.glb", "--text"], ".gltf");
    wrong(&["compare", "a.ply", "a.ply", "--heatmap", "b.stl"], ".ply");
    wrong(&["sample", "vase", "-o", "b.ply", "--triangles", "0"], "from 1 on");
    assert_eq!(folder.names(), ["a.ply"]);
    folder.done(&["convert", "a.ply", "-o", "b.off", "--text"]);
}

#[test]
fn a_sample_that_cannot_have_so_few_triangles_says_so() {
    let folder = Folder::new();
    let run = folder.done(&["sample", "mechanical", "-o", "a.ply", "--triangles", "5"]);
    assert!(run.stderr.contains("5 triangles are asked for, but"), "{}", run.stderr);
    let run = folder.done(&["sample", "statue", "-o", "a.ply", "--triangles", "5000"]);
    assert_eq!(run.stderr, "");
}

#[test]
fn refused_collapses_are_told_in_words() {
    let folder = Folder::new();
    let grid = Asset::from_mesh("grid", shapes::grid(20));
    maille_io::write(&grid, &folder.path("a.ply"), &WriteOptions::default()).expect("the grid can be written");
    let told = |policy: &str| {
        folder.done(&["simplify", "a.ply", "-o", "b.ply", "--max-error", "0", "--boundary", policy]).stdout
    };
    assert!(told("preserve").contains("that would tear open borders"), "{}", told("preserve"));
    assert!(told("lock").contains("between locked vertices"), "{}", told("lock"));
    let run = folder.done(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "2", "--boundary", "lock"]);
    assert!(run.stdout.contains("remedy   --boundary hold (or free)"), "{}", run.stdout);
}

#[test]
fn convert_goes_through_every_format_and_back() {
    let folder = with_sphere("a.ply");
    let mut from = "a.ply".to_owned();
    for extension in ["glb", "obj", "gltf", "stl", "off", "ply"] {
        let to = format!("b.{extension}");
        folder.done(&["convert", &from, "-o", &to]);
        let info = folder.json(&["info", &to]);
        assert_eq!((&info["triangles"], &info["format"]), (&2048.into(), &extension.into()));
        assert_eq!(info["meshes"][0]["closed"], true, "{to} has come apart");
        from = to;
    }
}

#[test]
fn info_tells_defects_and_repair_mends_them() {
    let folder = Folder::new();
    folder.file("fan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 9 9 9\nf 1 2 3\nf 1 2 3\nf 1 2 4\nf 2 2 3\n");
    let defects = |file: &str| {
        let info = folder.json(&["info", file]);
        let list = info["meshes"][0]["defects"].as_array().cloned().unwrap_or_default();
        list.iter().map(|defect| defect["defect"].as_str().unwrap_or_default().to_owned()).collect::<Vec<_>>()
    };
    let found = defects("fan.obj");
    assert!(found.iter().any(|name| name == "duplicate triangles"), "{found:?}");
    let report = folder.json(&["repair", "fan.obj", "-o", "mended.ply"]);
    assert_eq!(report["changes"]["duplicates_dropped"], 1);
    assert_eq!(defects("mended.ply"), [""; 0]);
    let only = folder.json(&["repair", "fan.obj", "-o", "part.ply", "--only", "drop-duplicates"]);
    assert_eq!((&only["repairs"], &only["changes"]["degenerate_dropped"]), (&["drop-duplicates"].into(), &0.into()));
}

#[test]
fn importance_and_locks_come_from_attributes() {
    let folder = Folder::new();
    let mut mesh = shapes::grid(20);
    let at_left: Vec<f32> = mesh.positions.iter().map(|p| if p[0] < 0.3 { 1.0 } else { 0.0 }).collect();
    let semantic = maille::Semantic::Custom("keep".to_owned());
    mesh.vertex_attributes.push(maille::Attribute::new_f32(semantic, 1, at_left));
    maille_io::write(&Asset::from_mesh("grid", mesh), &folder.path("a.ply"), &WriteOptions::default())
        .expect("the grid can be written");
    let report = folder.json(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "10", "--lock", "keep"]);
    assert!(report["triangles_out"].as_u64().is_some_and(|left| left >= 200), "{report}");
    folder.done(&["simplify", "a.ply", "-o", "b.ply", "--triangles", "100", "--importance", "keep"]);
    let run = folder.refused(&["simplify", "a.ply", "-o", "c.ply", "--ratio", "0.5", "--importance", "paint"], "a.ply");
    assert!(run.stderr.contains("paint") && run.stderr.contains("keep"), "{}", run.stderr);
}

#[test]
fn the_best_preset_fits_the_result_to_the_original() {
    let folder = Folder::new();
    folder.done(&["sample", "statue", "-o", "a.ply", "--triangles", "20000"]);
    let rms = |options: &[&str]| {
        let command = [&["simplify", "a.ply", "-o", "b.ply", "--triangles", "1000"], options].concat();
        let report = folder.json(&command);
        let compared = folder.json(&["compare", "a.ply", "b.ply", "--samples", "100000"]);
        (report["refit"].as_array().map_or(0, Vec::len), compared["rms"].as_f64().expect("a number"))
    };
    let (fitted, best) = rms(&["--preset", "best"]);
    let (left, exact) = rms(&["--preset", "best", "--refit=no"]);
    assert_eq!((fitted, left), (1, 0));
    assert!(best < 0.95 * exact, "{best} beside {exact}");
    assert_eq!(rms(&["--refit"]).0, 1);
}

#[test]
fn samples_are_listed_and_made() {
    let folder = Folder::new();
    let list = folder.done(&["sample", "--list"]).stdout;
    let names = folder.json(&["sample", "--list"])["names"].clone();
    let names: Vec<&str> = names.as_array().into_iter().flatten().filter_map(serde_json::Value::as_str).collect();
    assert!(names.contains(&"statue"));
    for name in names {
        assert!(list.contains(name), "{list}");
        let file = format!("{name}.glb");
        folder.done(&["sample", name, "-o", &file, "--triangles", "3000"]);
        let triangles = folder.json(&["info", &file])["triangles"].as_u64().unwrap_or(0);
        assert!((1000..20_000).contains(&triangles), "{name} has {triangles} triangles");
    }
    assert_eq!(folder.run(&["sample", "unicorn", "-o", "a.ply"]).code, 2);
}

#[test]
fn pictures_show_the_model_before_its_background() {
    let folder = with_sphere("a.ply");
    folder.done(&["render", "a.ply", "-o", "a.png", "--size", "80x60", "--background", "transparent"]);
    let picture = image::load_from_memory(&folder.bytes("a.png")).expect("it is a PNG").to_rgba8();
    assert_eq!(picture.dimensions(), (80, 60));
    assert_eq!((picture.get_pixel(40, 30)[3], picture.get_pixel(2, 2)[3]), (255, 0));
}

#[test]
fn completions_and_man_pages_know_every_command() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = folder.done(&["completions", shell]).stdout;
        assert!(COMMANDS.iter().all(|command| script.contains(command)), "{shell}");
    }
    assert!(folder.done(&["man"]).stdout.contains("maille"));
    folder.done(&["man", "-o", "man"]);
    for command in COMMANDS {
        assert!(folder.path("man").join(format!("maille-{command}.1")).exists(), "{command}");
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_is_no_failure() {
    use std::process::{Command, Stdio};
    let mut child = Command::new(env!("CARGO_BIN_EXE_maille"))
        .args(["completions", "zsh"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command has been built");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stderr).as_ref()), (Some(0), ""));
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_nothing_behind() {
    use std::process::{Command, Stdio};
    use std::time::Duration;
    let folder = Folder::new();
    let sphere = Asset::from_mesh("sphere", shapes::sphere(8));
    maille_io::write(&sphere, &folder.path("a.ply"), &WriteOptions::default()).expect("the sphere can be written");
    let child = Command::new(env!("CARGO_BIN_EXE_maille"))
        .args(["simplify", "a.ply", "-o", "b.ply", "--triangles", "10"])
        .current_dir(folder.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command has been built");
    // long enough to be at work, far too short to be done with half a million triangles
    std::thread::sleep(Duration::from_millis(600));
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill is there");
    assert!(kill.success());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(folder.names(), ["a.ply"]);
}
