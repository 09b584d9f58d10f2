//! Inputs that once failed, or that reach deep into a parser, through every parser of outside bytes:
//! `fuzz/seeds`. The campaigns themselves are `fuzz/run`.

#[cfg(feature = "service")]
#[path = "../../fuzz/src/rest.rs"]
mod rest;
#[path = "../../fuzz/src/targets.rs"]
#[allow(dead_code)]
mod targets;

use super::folders::project;

/// Hands every seed of a target to `take`.
fn each_seed(target: &str, mut take: impl FnMut(&[u8])) {
    let files: Vec<_> =
        std::fs::read_dir(project("fuzz/seeds").join(target)).unwrap().map(|f| f.unwrap().path()).collect();
    assert!(!files.is_empty(), "{target}");
    for file in files {
        take(&std::fs::read(file).unwrap());
    }
}

#[test]
fn seeds_of_files_are_read_or_refused_in_one_line() {
    let scratch = tempfile::tempdir().unwrap();
    each_seed("configuration", |bytes| _ = targets::configuration(bytes));
    each_seed("model", |bytes| _ = targets::model(bytes));
    for ending in ["csv", "parquet"] {
        each_seed(ending, |bytes| _ = targets::recording(bytes, ending, scratch.path()));
    }
    each_seed("mat", |bytes| _ = targets::mat(bytes, scratch.path()));
    let mut live = targets::Live::new();
    each_seed("keyframe", |bytes| _ = live.restore(bytes));
    let decisions = targets::Decisions::new();
    each_seed("evidence", |bytes| _ = decisions.read(bytes));
}

#[cfg(feature = "service")]
#[test]
fn seeds_of_samples_and_requests_are_taken_or_refused() {
    let mut live = targets::Live::new();
    each_seed("wire", |bytes| _ = targets::wire::batch(bytes, &mut live));
    each_seed("shdr", |bytes| _ = targets::wire::shdr(bytes));
    let mut site = rest::Site::new();
    each_seed("rest", |bytes| _ = site.ask(bytes));
}
