//! What is shipped beside the binary: alert rules, dashboard, unit, header, package.

use crate::folders::{not_run, project};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use stillcut::telemetry::Metrics;

fn deploy(path: &str) -> PathBuf {
    project("deploy").join(path)
}

/// Runs a tool; nothing where it is not installed.
fn tool(program: &str, arguments: &[&str], folder: &Path) -> Option<Output> {
    let output = Command::new(program).args(arguments).current_dir(folder).output();
    if output.is_err() {
        not_run(&format!("{program} is not installed"));
    }
    output.ok()
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn every_alert_fires_when_it_should_and_not_else() {
    for arguments in [["check", "rules", "stillcut.rules.yml"], ["test", "rules", "stillcut.rules.test.yml"]]
    {
        let Some(output) = tool("promtool", &arguments, &deploy("prometheus")) else { return };
        assert!(output.status.success(), "{}", said(&output));
    }
    let rules = std::fs::read_to_string(deploy("prometheus/stillcut.rules.yml")).unwrap();
    let tests = std::fs::read_to_string(deploy("prometheus/stillcut.rules.test.yml")).unwrap();
    let manual = std::fs::read_to_string(deploy("../docs/operations.md")).unwrap();
    for line in rules.lines() {
        let Some(name) = line.trim().strip_prefix("- alert: ") else { continue };
        assert!(tests.contains(&format!("alertname: {name}")), "{name} has a test");
        assert!(manual.contains(&format!("### {name}\n")), "{name} is explained");
    }
}

/// Names of our metrics in a text.
fn metric_names(text: &str) -> Vec<String> {
    let parts = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
    parts.filter(|p| p.starts_with("stillcut_")).map(str::to_owned).collect()
}

#[test]
fn rules_and_dashboard_ask_for_metrics_that_exist() {
    let metrics = Metrics::new(&["x1".into()], 0.0).unwrap();
    metrics.set_config_hash("0").unwrap();
    metrics.http_request_duration_seconds.with_label_values(&["live", "2xx"]).observe(0.0);
    for family in [&metrics.last_sample_timestamp_seconds, &metrics.chatter_frequency_hertz] {
        Metrics::show(family, &[], Some(0.0));
    }
    let exported = metric_names(&metrics.text().unwrap());
    for file in ["prometheus/stillcut.rules.yml", "grafana/stillcut.json"] {
        let asked = metric_names(&std::fs::read_to_string(deploy(file)).unwrap());
        assert!(asked.len() > 9, "{file}");
        for name in asked {
            assert!(exported.contains(&name), "{file}: {name} is not exported");
        }
    }
    let text = std::fs::read_to_string(deploy("grafana/stillcut.json")).unwrap();
    let dashboard: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(dashboard["uid"], "stillcut-overview");
    assert!(
        dashboard["panels"].as_array().unwrap().iter().all(|p| p["datasource"]["uid"] == "${datasource}")
    );
}

#[test]
fn the_unit_is_hardened() {
    let arguments = ["security", "--offline=true", "stillcut.service"];
    let Some(output) = tool("systemd-analyze", &arguments, &deploy("systemd")) else { return };
    let text = said(&output);
    let Some(score) = text.split("exposure level for stillcut.service: ").nth(1) else {
        not_run("this systemd-analyze cannot read units offline");
        return;
    };
    let score: f64 = score.split_whitespace().next().unwrap().parse().unwrap();
    assert!(score <= 1.5, "{text}");
}

/// Status 2 ends the tries, but only that of `ExecStart`; a child that takes too much memory ends alone.
#[test]
fn a_wrong_configuration_is_not_tried_again_and_again() {
    let unit = std::fs::read_to_string(deploy("systemd/stillcut.service")).unwrap();
    let has = |line: &str| unit.lines().any(|l| l == line);
    assert!(has("Restart=always") && has("RestartPreventExitStatus=2") && has("OOMPolicy=continue"));
    assert!(!unit.lines().any(|l| l.starts_with("ExecStartPre=")), "its status would prevent nothing");
}

/// The diagnosis and all threads but the pipeline's go last by `nice` and `renice`, which the unit must let them do.
#[test]
fn the_unit_lets_the_service_step_back() {
    let unit = std::fs::read_to_string(deploy("systemd/stillcut.service")).unwrap();
    let filters: Vec<&str> = unit.lines().filter_map(|l| l.strip_prefix("SystemCallFilter=")).collect();
    let barred = filters.iter().position(|f| f.starts_with('~') && f.contains("@resources")).unwrap();
    let allowed = filters.iter().position(|f| *f == "setpriority").unwrap();
    assert!(allowed > barred, "what is named later adds to what is barred before: {filters:?}");
}

#[test]
fn the_c_header_has_the_layout_of_the_wire() {
    let arguments =
        ["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", "-x", "c", "stillcut.h"];
    let Some(output) = tool("cc", &arguments, &deploy("include")) else { return };
    assert!(output.status.success(), "{}", said(&output));
    // The sizes that the header asserts are those of the Rust types.
    let header = std::fs::read_to_string(deploy("include/stillcut.h")).unwrap();
    use stillcut::transport::wire::{ServoBatch, ServoPoint, TurretCommand, TurretStatus};
    for (name, size) in [
        ("ServoPoint", size_of::<ServoPoint>()),
        ("ServoBatch", size_of::<ServoBatch>()),
        ("TurretCommand", size_of::<TurretCommand>()),
        ("TurretStatus", size_of::<TurretStatus>()),
    ] {
        assert!(header.contains(&format!("sizeof(Stillcut{name}) == {size}")), "{name}: {size}");
    }
}

#[test]
fn what_the_package_holds_exists() {
    let root = project("");
    let manifest: toml::Table =
        toml::from_str(&std::fs::read_to_string(root.join("Cargo.toml")).unwrap()).unwrap();
    let deb = &manifest["package"]["metadata"]["deb"];
    for asset in deb["assets"].as_array().unwrap() {
        let source = asset[0].as_str().unwrap();
        assert!(source.starts_with("target/") || root.join(source).is_file(), "{source}");
    }
    assert!(root.join(deb["maintainer-scripts"].as_str().unwrap()).join("postinst").is_file());
}

/// Manual page and completions of the package are those of the program; `worker` is in no default build.
#[test]
fn manual_and_completions_are_those_of_the_program() {
    if cfg!(feature = "nats") {
        not_run("a build with the fleet has one command more");
        return;
    }
    for (arguments, file) in [
        (&["man"][..], "man/stillcut.1"),
        (&["completions", "bash"], "completions/stillcut.bash"),
        (&["completions", "zsh"], "completions/_stillcut"),
        (&["completions", "fish"], "completions/stillcut.fish"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_stillcut")).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", said(&output));
        let shipped = std::fs::read_to_string(deploy(file)).unwrap();
        let same = String::from_utf8_lossy(&output.stdout) == shipped;
        assert!(same, "stillcut {} > deploy/{file}", arguments.join(" "));
    }
    let page = std::fs::read_to_string(deploy("man/stillcut.1")).unwrap();
    for part in [".SH \"STILLCUT RUN\"", ".SS OPTIONS", ".SH \"EXIT STATUS\""] {
        assert!(page.contains(part), "{part}");
    }
}
