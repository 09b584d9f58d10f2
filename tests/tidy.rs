//! The structure of the crate, held by reading its source: who imports whom, sizes, banned words.
//!
//! The table is the one of `docs/architecture.md`. Test modules are exempt from the import table.

use std::fs;
use std::path::{Path, PathBuf};

/// Module, and what of the crate it may use beside `units` and `sample`.
const MAY_USE: &[(&str, &[&str])] = &[
    ("keyframe", &[]),
    ("units", &[]),
    ("sample", &[]),
    ("signal", &[]),
    ("plant", &[]),
    ("gate", &["signal"]),
    ("force", &["signal", "plant"]),
    ("chatter", &["signal"]),
    ("avoidance", &["chatter", "stability", "plant"]),
    ("stability", &["plant", "chatter", "signal"]),
    ("pipeline", &["force", "chatter", "avoidance", "stability", "plant", "signal"]),
    ("simulation", &["plant", "signal", "pipeline", "avoidance", "chatter"]),
    ("identify", &["plant", "signal", "force", "simulation"]),
    ("diagnosis", &["plant", "signal", "force", "stability", "simulation", "identify", "gate"]),
    (
        "config",
        &[
            "plant",
            "force",
            "chatter",
            "avoidance",
            "stability",
            "pipeline",
            "signal",
            "diagnosis",
            "identify",
            "simulation",
        ],
    ),
    ("recording", &["gate", "plant", "force", "chatter", "avoidance", "pipeline", "config", "diagnosis"]),
    (
        "report",
        &[
            "plant",
            "force",
            "chatter",
            "avoidance",
            "stability",
            "pipeline",
            "diagnosis",
            "gate",
            "identify",
            "recording",
            "config",
            "simulation",
            "signal",
        ],
    ),
    ("telemetry", &["plant", "force", "chatter", "avoidance", "pipeline"]),
    ("ownership", &[]),
    ("transport", &["avoidance", "telemetry", "pipeline", "ownership"]),
    ("store", &["avoidance", "chatter", "pipeline", "telemetry", "recording", "ownership"]),
    (
        "http",
        &[
            "service",
            "telemetry",
            "config",
            "chatter",
            "avoidance",
            "pipeline",
            "stability",
            "plant",
            "report",
        ],
    ),
];

/// Shell crates that the core must not know.
const SHELL_CRATES: &[&str] =
    &["tokio", "axum", "sqlx", "iceoryx2", "parquet", "clap", "serde", "prometheus", "tracing"];
const CORE: &[&str] = &[
    "keyframe",
    "units",
    "sample",
    "signal",
    "plant",
    "gate",
    "force",
    "chatter",
    "avoidance",
    "stability",
    "pipeline",
    "simulation",
    "identify",
    "diagnosis",
];
/// Words of work left undone, in two halves so that a plain search for them does not end here.
const BANNED: [[&str; 2]; 5] =
    [["to", "do!("], ["unimpl", "emented!("], ["FIX", "ME"], ["XX", "X"], ["#[ig", "nore"]];
const LONGEST_FILE: usize = 600;
const LONGEST_LINE: usize = 110;
/// Markup and style sheets inside of string literals, one element a line.
const LONGEST_MARKUP: usize = 146;

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Every source file with its top module and its text up to the first test module.
fn files() -> Vec<(PathBuf, String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    sources(&root, &mut paths);
    assert!(paths.len() > 50, "only {} sources found", paths.len());
    let read = |path: PathBuf| {
        let inside = path.strip_prefix(&root).unwrap().to_owned();
        let first = inside.components().next().unwrap().as_os_str().to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs").to_owned();
        let text = fs::read_to_string(&path).unwrap();
        (inside, module, text)
    };
    paths.into_iter().map(read).collect()
}

fn without_tests(text: &str) -> &str {
    text.split("#[cfg(test)]").next().unwrap_or(text)
}

/// Modules of the crate named in `crate::a` or `crate::{a, b::c}`.
fn imported(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for line in text.lines().filter(|l| !l.trim_start().starts_with("//")) {
        for part in line.split("crate::").skip(1) {
            if let Some(group) = part.strip_prefix('{') {
                let names = group.split('}').next().unwrap_or(group).split(',');
                found.extend(names.map(|n| n.trim().split("::").next().unwrap_or("").to_owned()));
            } else {
                let end = part.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(part.len());
                found.push(part[..end].to_owned());
            }
        }
    }
    found.retain(|n| !n.is_empty());
    found
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let mut complaints = Vec::new();
    for (path, module, text) in files() {
        let Some((_, allowed)) = MAY_USE.iter().find(|(m, _)| *m == module) else { continue };
        for name in imported(without_tests(&text)) {
            let known =
                MAY_USE.iter().any(|(m, _)| *m == name) || ["cli", "service"].contains(&name.as_str());
            let fine = name == module
                || ["keyframe", "units", "sample"].contains(&name.as_str())
                || allowed.contains(&name.as_str());
            if known && !fine {
                complaints.push(format!("{} uses crate::{name}", path.display()));
            }
        }
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn the_core_knows_nothing_of_the_shell() {
    for (path, module, text) in files() {
        if !CORE.contains(&module.as_str()) {
            continue;
        }
        for line in without_tests(&text).lines() {
            let line = line.trim_start();
            for name in SHELL_CRATES {
                assert!(!line.starts_with(&format!("use {name}::")), "{} uses {name}", path.display());
            }
            for outside in ["std::fs", "std::net", "SystemTime", "Instant::now", "println!", "eprintln!"] {
                let code = line.split("//").next().unwrap_or("");
                assert!(!code.contains(outside), "{} uses {outside}: {line}", path.display());
            }
        }
    }
}

#[test]
fn files_and_lines_stay_readable() {
    let mut complaints = Vec::new();
    for (path, _, text) in files() {
        let lines = without_tests(&text).lines().count();
        if lines > LONGEST_FILE {
            complaints.push(format!("{}: {lines} lines", path.display()));
        }
        for (number, line) in text.lines().enumerate() {
            let length = line.chars().count();
            let longest = if path.starts_with("report") { LONGEST_MARKUP } else { LONGEST_LINE };
            if length > longest && !line.contains("http") {
                complaints.push(format!("{}:{}: {length} characters", path.display(), number + 1));
            }
        }
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn nothing_is_left_undone_or_switched_off() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut complaints = Vec::new();
    for folder in ["src", "tests", "benches", "examples", "fuzz/src", "fuzz/fuzz_targets"] {
        let mut paths = Vec::new();
        sources(&root.join(folder), &mut paths);
        assert!(!paths.is_empty(), "{folder} has sources");
        for path in paths {
            let text = fs::read_to_string(&path).unwrap();
            let found =
                BANNED.map(|halves| halves.concat()).into_iter().filter(|word| text.contains(word.as_str()));
            complaints.extend(found.map(|word| format!("{}: {word}", path.display())));
        }
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn unsafe_stays_where_it_is_allowed() {
    for (path, _, text) in files() {
        let name = path.to_string_lossy().replace('\\', "/");
        let allowed = [
            "transport/wire.rs",
            "signal/sliding_dft_kernel.rs",
            "signal/dispatch.rs",
            "signal/inner_products.rs",
        ]
        .contains(&name.as_str());
        let code = text.lines().filter(|l| !l.trim_start().starts_with("//"));
        let found = code
            .clone()
            .any(|l| l.contains("unsafe {") || l.contains("unsafe fn") || l.contains("allow(unsafe_code)"));
        assert!(!found || allowed, "unsafe code in {name}");
    }
}
