//! `capture --wait`: a node that may be opened a while after it has appeared, and one that never may.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::models::{Prepared, model, scene};
use crate::umockdev::{Mocked, output_of_nobody};

/// Of a user who is nobody, in a folder that everybody may write: waits for a DVS128 and captures all of it.
fn capture(mocked: &Mocked, folder: &tempfile::TempDir, events: usize) -> Command {
    use std::os::unix::fs::PermissionsExt;
    let open = std::fs::Permissions::from_mode(0o777);
    std::fs::set_permissions(folder.path(), open).unwrap();
    let mut command = mocked.command_for_nobody(env!("CARGO_BIN_EXE_eecvs-usb"));
    command
        .current_dir(folder.path())
        .args(["capture", "--wait", "--json", "--duration-s", "30"])
        .args(["-o", "a.aedat4", "--events", &events.to_string()]);
    command
}

fn dvs128() -> Option<(Mocked, usize)> {
    let model = model("dvs128");
    let sensor = crate::models::sensor(model).unwrap();
    let events = scene(sensor);
    let camera = model.camera(sensor, Prepared::boxed(model, sensor, &events));
    Mocked::new(camera.unwrap()).map(|mocked| (mocked, events.len()))
}

fn ended_within(child: &mut Child, time: Duration) -> bool {
    let until = Instant::now() + time;
    while Instant::now() < until {
        if child.try_wait().unwrap().is_some() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    false
}

#[test]
fn permissions_may_settle_after_the_arrival() {
    let Some((mocked, events)) = dvs128() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    mocked.forbid();
    // Whether the system lets a test be nobody.
    if output_of_nobody(&mut mocked.command_for_nobody("true")).is_none() {
        return;
    }
    let mut command = capture(&mocked, &folder, events);
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // As udev does, after the kernel's announcement.
    assert!(!ended_within(&mut child, Duration::from_millis(700)));
    assert!(!folder.path().join("a.aedat4").exists());
    mocked.permit();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(said["events"], events, "{said}");
    assert_eq!(said["losses"], serde_json::json!({}), "{said}");
}

#[test]
fn a_permission_that_never_comes_is_one_line() {
    let Some((mocked, events)) = dvs128() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    mocked.forbid();
    let started = Instant::now();
    let Some(output) = output_of_nobody(&mut capture(&mocked, &folder, events)) else {
        return;
    };
    assert!(
        started.elapsed() >= Duration::from_secs(2),
        "given up early"
    );
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("ATTR{idProduct}==\"8400\""), "{text}");
    assert!(!folder.path().join("a.aedat4").exists());
}
