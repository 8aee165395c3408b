//! The calibration as programs of others see it: its record, and what is served to viewers.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs,
    net::TcpStream,
    path::Path,
    process::{Command, Output},
};

use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::{ClientRequestBuilder, Message, WebSocket, stream::MaybeTlsStream};

use crate::harness::{Run, Scratch};

/// Records a short calibration; returns the lines of each channel by what `ctos log info` says.
fn recorded(scratch: &Scratch, arguments: &[&str]) -> BTreeMap<String, u64> {
    let record = ["--set", "time.mode=\"virtual\"", "--record", "run.mcap"];
    scratch.boot(&[arguments, &record].concat()).must_exit(0);
    let info = scratch.ctos(&["log", "info", "--json", "run.mcap"]);
    info.must_exit(0);
    let info = info.json();
    assert!(info["torn"].is_null() && info["lost"] == 0, "{info}");
    let channels = info["channels"].as_object().unwrap().iter();
    channels
        .map(|(topic, channel)| (topic.clone(), channel["lines"].as_u64().unwrap()))
        .collect()
}

#[test]
fn the_record_of_a_boot_has_scene_joints_and_pictures_for_viewers_and_an_app_may_do_without() {
    let scratch = Scratch::short();
    let channels = recorded(&scratch, &[]);
    let lines = |topic: &str| channels.get(topic).copied().unwrap_or(0);
    assert!(lines("/tf/state") > 100, "{channels:?}");
    assert_eq!(lines("/tf/state"), lines("/joints/state"));
    // Once at the beginning, and when a planned way comes or goes.
    let drawn = lines("/solids/state");
    assert!(2 < drawn && drawn <= lines("/tf/state") / 2, "{channels:?}");
    for camera in ["ceiling_west", "ceiling_east"] {
        let on = |what: &str| lines(&format!("/camera/{camera}/{what}"));
        assert!(
            on("image") > 10 && on("marks") >= on("image"),
            "{channels:?}"
        );
        assert!(lines(&format!("/picture/{camera}")) >= on("image"));
    }
    assert!(lines("/scene/state") > 100, "{channels:?}");
    // What is no JSON is told as what it is, and not printed.
    let cat = ["log", "cat", "run.mcap", "--topic", "/solids/*", "--json"];
    let told = scratch.ctos(&cat);
    let first = told.stdout.lines().next().unwrap();
    let line: Value = serde_json::from_str(first).unwrap();
    assert_eq!(line["schema"], "foxglove.SceneUpdate");
    assert_eq!(line["line"]["encoding"], "protobuf");
}

#[test]
fn of_chosen_channels_nothing_else_is_recorded_and_the_record_is_small() {
    let scratch = Scratch::short();
    let chosen = "record.channels=[\"/tf/*\", \"/camera/*\", \"/firing/dispatcher\"]";
    let channels = recorded(&scratch, &["--set", chosen]);
    let size = || std::fs::metadata(scratch.path("run.mcap")).unwrap().len();
    let small = size();
    for (topic, lines) in &channels {
        let wanted = ["/tf/", "/camera/"]
            .iter()
            .any(|root| topic.starts_with(root));
        let wanted = wanted || topic == "/firing/dispatcher";
        assert!(wanted || *lines == 0, "{channels:?}");
    }
    assert!(channels["/tf/state"] > 100 && channels["/firing/dispatcher"] > 10);
    std::fs::remove_file(scratch.path("run.mcap")).unwrap();
    recorded(&scratch, &[]);
    assert!(5 * small < size(), "{small} of {}", size());
}

/// A script of Python beside this file, with what it prints as JSON.
fn python(script: &str, arguments: &[&OsStr]) -> Value {
    let ended = run_python(script, arguments);
    let told = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "{told}");
    serde_json::from_slice(&ended.stdout).unwrap()
}

/// What a reader says that fails.
fn failed(script: &str, arguments: &[&OsStr]) -> String {
    let ended = run_python(script, arguments);
    assert!(!ended.status.success());
    String::from_utf8_lossy(&ended.stderr).into_owned()
}

fn run_python(script: &str, arguments: &[&OsStr]) -> Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("system/viewers");
    let python = std::env::var("CTOS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut command = Command::new(python);
    command.arg(folder.join(script)).args(arguments);
    command.output().unwrap()
}

#[test]
#[ignore = "needs the Python packages mcap, mcap-protobuf-support and opencv: CTOS_PYTHON names a Python that has them"]
fn readers_of_others_read_every_channel_and_find_the_arm_where_its_joints_say() {
    let scratch = Scratch::short();
    let channels = recorded(&scratch, &[]);
    let found = python("read.py", &[scratch.path("run.mcap").as_ref()]);
    let foreign = |topic: &str| {
        let roots = [
            "/tf/",
            "/solids/",
            "/joints/",
            "/numbers/",
            "/said/",
            "/camera/",
        ];
        roots.iter().any(|root| topic.starts_with(root))
    };
    let written: BTreeMap<String, u64> = channels
        .into_iter()
        .filter(|(topic, _)| foreign(topic))
        .collect();
    let counted: BTreeMap<String, u64> = serde_json::from_value(found["decoded"].clone()).unwrap();
    assert_eq!(counted, written);
    // The model of the arm, by its kinematics, is not what the reader has: link lengths must stay as they are.
    let links = found["link_spread_m"].as_f64().unwrap();
    assert!(
        links < 2e-5,
        "the distance of two joints' frames changed by {links} m"
    );
    assert!(found["moved_m"].as_f64().unwrap() > 0.5, "{found}");
    assert_eq!(found["joints"].as_array().unwrap().len(), 6, "{found}");
    assert_eq!(
        found["unplaced"], 0,
        "solids in a frame that no transform names: {found}"
    );
    // The lamp is brighter than what is around it.
    assert!(found["marks"].as_u64().unwrap() > 10, "{found}");
    assert!(found["least_contrast"].as_f64().unwrap() > 15.0, "{found}");
}

/// A viewer by a client that is not ours, with the protocol's own words.
struct Viewer {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    /// Names of the channels, by id.
    channels: BTreeMap<u64, String>,
    /// Messages of each channel that came.
    came: BTreeMap<String, Vec<Vec<u8>>>,
}

impl Viewer {
    fn connect(address: &str, protocol: &str) -> Result<Self, tungstenite::Error> {
        let request = ClientRequestBuilder::new(address.parse().unwrap());
        Self::ask(request.with_sub_protocol(protocol))
    }

    fn ask(request: ClientRequestBuilder) -> Result<Self, tungstenite::Error> {
        let (socket, _) = tungstenite::connect(request)?;
        Ok(Self {
            socket,
            channels: BTreeMap::new(),
            came: BTreeMap::new(),
        })
    }

    /// Reads the next message; subscribes to each channel that is told, under the channel's own number.
    fn read(&mut self) {
        match self.socket.read().unwrap() {
            Message::Text(text) => {
                let told: Value = serde_json::from_str(&text).unwrap();
                let channels = told["channels"].as_array();
                if told["op"] != "advertise" {
                    return;
                }
                for channel in channels.unwrap() {
                    let id = channel["id"].as_u64().unwrap();
                    let name = channel["topic"].as_str().unwrap().to_owned();
                    self.channels.insert(id, name);
                    let subscribe = json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": id }] });
                    self.socket
                        .send(Message::text(subscribe.to_string()))
                        .unwrap();
                }
            }
            Message::Binary(bytes) if bytes[0] == 1 => {
                let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                let channel = self.channels[&u64::from(id)].clone();
                self.came
                    .entry(channel)
                    .or_default()
                    .push(bytes[13..].to_vec());
            }
            _ => {}
        }
    }

    fn count(&self, channel: &str) -> usize {
        self.came.get(channel).map_or(0, Vec::len)
    }
}

/// Boots the calibration with a server for viewers; tells its address, and the address with the token.
fn served(scratch: &Scratch) -> (Run<'_>, String, String) {
    let (mut run, address, with_token) = opened(scratch, &["--foxglove=127.0.0.1:0"]);
    run.wait_for("phase 3");
    (run, address, with_token)
}

/// Boots the calibration, which serves viewers.
fn opened<'s>(scratch: &'s Scratch, arguments: &[&str]) -> (Run<'s>, String, String) {
    let mut run = scratch.start_boot(arguments);
    let line = run.line_with("viewers may connect");
    let field = |name: &str| {
        let (_, rest) = line.split_once(name).unwrap();
        rest.split([' ', '"', '\n', '\u{1b}'])
            .find(|text| !text.is_empty())
            .unwrap()
            .to_owned()
    };
    let with_token = fs::read_to_string(field("open=")).unwrap();
    (run, field("address="), with_token.trim().to_owned())
}

#[test]
fn a_viewer_that_comes_late_is_told_the_whole_beside_one_that_stops_reading() {
    let scratch = Scratch::new();
    let (run, address, _) = served(&scratch);
    let stuck = Viewer::connect(&address, "foxglove.sdk.v1.1").unwrap();
    for protocol in ["foxglove.sdk.v1", "foxglove.sdk.v1.1"] {
        let mut viewer = Viewer::connect(&address, protocol).unwrap();
        // The parts of the arm were told once, before this viewer came.
        while viewer.count("/solids/state") == 0
            || viewer.count("/tf/state") < 30
            || viewer.count("/camera/ceiling_west/image") < 2
        {
            viewer.read();
        }
        let image = &viewer.came["/camera/ceiling_west/image"][1];
        let has_jpeg = image.windows(3).any(|bytes| bytes == [0xff, 0xd8, 0xff]);
        assert!(has_jpeg);
    }
    assert!(Viewer::connect(&address, "foxglove.websocket.v1").is_err());
    drop(stuck);
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
#[ignore = "needs the Python packages websocket-client, mcap-protobuf-support and opencv: CTOS_PYTHON names a Python that has them"]
fn a_client_of_others_subscribes_and_reads_poses_and_pictures_by_their_schemas() {
    let scratch = Scratch::new();
    let (run, address, _) = served(&scratch);
    let found = python("live.py", &[address.as_ref()]);
    assert_eq!(found["protocol"], "foxglove.sdk.v1");
    assert!(found["transforms"].as_u64().unwrap() >= 20, "{found}");
    assert!(found["joints"].as_u64().unwrap() == 6, "{found}");
    assert!(found["pictures"].as_u64().unwrap() >= 2, "{found}");
    assert_eq!(found["undecoded"], 0, "{found}");
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_page_of_another_site_looks_on_with_the_token_alone_and_an_installed_viewer_without() {
    let scratch = Scratch::new();
    let (run, address, with_token) = served(&scratch);
    let from = |address: &str, origin: &str| {
        let request = ClientRequestBuilder::new(address.parse().unwrap());
        let request = request.with_sub_protocol("foxglove.sdk.v1");
        Viewer::ask(request.with_header("Origin", origin))
    };
    let site = "https://viewer.example";
    let refused = from(&address, site).err().unwrap().to_string();
    assert!(refused.contains("403"), "{refused}");
    let guessed = format!("{address}?token=0123456789abcdef0123456789abcdef");
    assert!(from(&guessed, site).is_err());
    for (address, origin) in [(&with_token, site), (&address, "file://")] {
        let mut viewer = from(address, origin).unwrap();
        while viewer.count("/tf/state") == 0 {
            viewer.read();
        }
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
#[ignore = "needs the Python packages websocket-client, mcap-protobuf-support and opencv: CTOS_PYTHON names a Python that has them"]
fn beyond_the_loopback_viewers_come_with_keys_encrypted_and_with_the_token() {
    let scratch = Scratch::new();
    let made = scratch.ctos(&["keys", "new", "configs/keys/cell", "--role", "boot"]);
    made.must_exit(0);
    let keys = "security={ key = \"keys/cell\", authority = \"keys/ca.pem\" }";
    let (mut run, address, with_token) = opened(&scratch, &["--foxglove=0.0.0.0:0", "--set", keys]);
    run.wait_for("phase 3");
    assert!(address.starts_with("wss://0.0.0.0:"), "{address}");
    let here = |address: &str| address.replacen("0.0.0.0", "127.0.0.1", 1);
    let unencrypted = here(&with_token).replacen("wss", "ws", 1);
    assert!(Viewer::connect(&unencrypted, "foxglove.sdk.v1").is_err());
    let authority = scratch.path("configs/keys/ca.pem");
    let found = python("live.py", &[here(&with_token).as_ref(), authority.as_ref()]);
    assert!(found["transforms"].as_u64().unwrap() >= 20, "{found}");
    let refused = failed("live.py", &[here(&address).as_ref(), authority.as_ref()]);
    assert!(refused.contains("403"), "{refused}");
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn a_record_does_not_grow_because_somebody_looks_on() {
    let scratch = Scratch::new();
    let (mut run, address, _) = opened(
        &scratch,
        &["--foxglove=127.0.0.1:0", "--record", "run.mcap"],
    );
    run.wait_for("phase 3");
    // Each subscribes to every channel, and is told the whole each time.
    for _ in 0..4 {
        let mut viewer = Viewer::connect(&address, "foxglove.sdk.v1").unwrap();
        while viewer.count("/solids/state") == 0 || viewer.count("/tf/state") < 15 {
            viewer.read();
        }
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
    let lines = |topic: &str| {
        let cat = ["log", "cat", "run.mcap", "--topic", topic, "--json"];
        scratch.ctos(&cat).json_lines()
    };
    // The parts are recorded when there are others, and for nobody else.
    let scenes = lines("/scene/state");
    let views = scenes
        .iter()
        .filter(|step| step["line"]["view"].is_object());
    assert_eq!(lines("/solids/state").len(), views.count());
}

#[test]
fn a_record_keeps_the_layouts_of_the_app_for_whoever_shows_it_without_the_app() {
    let scratch = Scratch::short();
    recorded(&scratch, &[]);
    std::fs::remove_file(scratch.path("configs/displays/calibrate.toml")).unwrap();
    let export = ["display", "run.mcap", "--export", "run.html"];
    scratch.ctos(&export).must_exit(0);
    let page = scratch.read("run.html");
    for layout in ["following", "seeing"] {
        assert!(page.contains(&format!("\"name\":\"{layout}\"")), "{layout}");
    }
    // A file that a person names comes first, and what is wrong in it is told.
    scratch.write("mine.toml", "[layout.mine]\npanes = [\"scene\"]\n");
    let named = [&export[..], &["--displays", "mine.toml"]].concat();
    scratch.ctos(&named).must_exit(0);
    let page = scratch.read("run.html");
    assert!(page.contains("\"name\":\"mine\"") && !page.contains("\"name\":\"following\""));
}

#[test]
fn rubbish_from_a_viewer_ends_nothing_but_perhaps_its_own_connection() {
    let scratch = Scratch::new();
    let (run, address, _) = served(&scratch);
    for rubbish in [
        Message::text("this is no order"),
        Message::text(r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":99999}]}"#),
        Message::text(r#"{"op":"advertise","channels":[{"id":1,"topic":"x","encoding":"json"}]}"#),
        Message::binary(vec![1, 2, 3]),
        Message::binary(vec![0xff; 100_000]),
    ] {
        let mut viewer = Viewer::connect(&address, "foxglove.sdk.v1").unwrap();
        viewer.socket.send(rubbish).unwrap();
        let mut after = Viewer::connect(&address, "foxglove.sdk.v1").unwrap();
        while after.count("/tf/state") < 3 {
            after.read();
        }
    }
    run.signal(Signal::INT);
    run.end().must_exit(130);
}

#[test]
fn viewers_that_are_killed_come_back_and_the_robot_goes_on_meanwhile() {
    let scratch = Scratch::short();
    let mut run = scratch.start_boot(&["--foxglove=127.0.0.1:0"]);
    run.wait_for("phase 3");
    run.kill("viewers");
    run.wait_for("viewers is up again");
    run.end().must_exit(0);
}
