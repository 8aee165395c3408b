//! Programs in Python in apps that people boot: a Tool that finds the spot, a control room, a service object.

use std::{fs, process::Command};

use crate::common::{configurations, root};

fn ctos() -> Command {
    Command::new(env!("CARGO_BIN_EXE_ctos"))
}

/// The Python of the tests.
fn python() -> String {
    std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

fn imports(modules: &str) -> bool {
    let run = std::process::Command::new(python())
        .args(["-c", &format!("import {modules}")])
        .output();
    run.is_ok_and(|run| run.status.success())
}

/// The arguments of a program of `configs/programs` in another folder.
fn program(name: &str) -> String {
    let file = root().join("configs/programs").join(name);
    let client = root().join("clients/python/src");
    format!(
        "command = [{:?}, {:?}]\nenvironment.PYTHONPATH = {:?}\n",
        python(),
        file.display().to_string(),
        client.display().to_string()
    )
}

/// What the app `calibrate` tells in virtual time, with other words in its file.
fn calibrate(from: &str, to: &str) -> serde_json::Value {
    let folder = configurations();
    let app = folder.path().join("configs/calibrate.toml");
    let text = fs::read_to_string(&app).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(&app, text.replace(from, to)).unwrap();
    let run = ctos()
        .arg("boot")
        .arg(&app)
        .args(["--set", "time.mode=\"virtual\"", "--json"])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&run.stdout).into_owned();
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{told}{said}");
    let last = told
        .lines()
        .rev()
        .find_map(|line| serde_json::from_str(line).ok());
    last.unwrap_or_else(|| panic!("{told}{said}"))
}

#[test]
#[ignore = "needs the Python packages opencv and numpy: CTOS_PYTHON names a Python that has them"]
fn opencv_finds_the_spot_and_the_cameras_are_computed_as_well() {
    let own = calibrate("toolSpotFind", "toolSpotFind");
    let spot = format!(
        "[vss.handlers]\ntoolSpotFind = \"ctos.program\"\n[vss.args.toolSpotFind]\nstands_in_for = [\"vss.tool_spot_find\"]\n{}",
        program("spot.py")
    );
    let ours = "[vss.args.toolSpotFind]\nmax_sigma_px = 4.0\n";
    let theirs = calibrate(ours, &spot);
    let cameras = |told: &serde_json::Value| told["cameras"].as_array().unwrap().clone();
    assert_eq!(cameras(&theirs).len(), 2, "{theirs}");
    for (own, other) in cameras(&own).iter().zip(&cameras(&theirs)) {
        for key in ["rms_true_px", "position_sd_m", "focal_sd_rel"] {
            let (own, other) = (own[key].as_f64().unwrap(), other[key].as_f64().unwrap());
            assert!(other < 1.15 * own, "{key}: {other}, ours {own}");
        }
        let number = |key: &str| other[key].as_f64().unwrap();
        assert!(
            number("position_error_m") < 3.0 * number("position_sd_m"),
            "{other}"
        );
        assert!(
            number("spots") >= own["spots"].as_f64().unwrap() - 3.0,
            "{other}"
        );
    }
}

#[test]
fn a_script_commands_the_dispatcher_and_has_the_result_judged() {
    if !imports("json") {
        return;
    }
    let text = fs::read_to_string(root().join("configs/calibrate.toml")).unwrap();
    let start = text.find("[task.operator]").unwrap();
    let end = start + text[start..].find("\n# Holds").unwrap();
    let room = format!(
        "[task.operator]\nhandler = \"ctos.program\"\non = \"ws1\"\n[task.operator.args]\nasks = [\"dispatcher\", \"referee\"]\n\
         args = {{ symbol = \"calibrate_camera\", arguments = [\"enough=80%\"], success = \"calibration_done\", judge = \"referee\" }}\n{}",
        program("control_room.py")
    );
    let told = calibrate(&text[start..end], &room);
    assert!(told.to_string().contains("reprojection RMS"), "{told}");
}

#[test]
fn an_app_in_python_is_written_and_runs_the_same_every_time() {
    if !imports("json") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let app = folder.path().join("thick");
    let made = ctos().args(["new", "--python"]).arg(&app).output().unwrap();
    assert!(made.status.success(), "{made:?}");
    let run = |seed: &str| {
        let run = ctos()
            .arg("sim")
            .arg(app.join("app.toml"))
            .args(["--seed", seed])
            .env("CTOS_PYTHON", python())
            .output()
            .unwrap();
        assert!(run.status.success(), "{run:?}");
        String::from_utf8(run.stdout).unwrap()
    };
    let first = run("7");
    assert!(first.contains("mm, sd 0.00"), "{first}");
    assert_eq!(first, run("7"));
    assert_ne!(first, run("8"));
    let boot = ctos()
        .arg("boot")
        .arg(app.join("app.toml"))
        .env("CTOS_PYTHON", python())
        .output()
        .unwrap();
    assert!(boot.status.success(), "{boot:?}");
}
