//! Chromium without a window, driven by its DevTools protocol: opens pages, asks them questions, takes pictures.
//!
//! Nothing here sleeps: a question waits in the page for what it asks about, and a silent browser fails the
//! test by the time limit of the connection.

use std::{
    io::{BufRead, BufReader},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    time::Duration,
};

use base64::{Engine as _, prelude::BASE64_STANDARD as BASE64};
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket, stream::MaybeTlsStream};

/// A browser that says nothing for so long has failed the test.
const SILENCE: Duration = Duration::from_secs(60);
/// How long a page may take to become what a test waits for, ms.
const PATIENCE_MS: u32 = 40_000;

/// Names under which systems have it.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// A browser with one page.
pub struct Browser {
    process: Child,
    _profile: tempfile::TempDir,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    asked: u64,
    /// What the page wrote to its console as an error, and exceptions.
    pub complaints: Vec<String>,
}

impl Browser {
    /// Starts a browser and opens a page in it.
    pub fn open(url: &str, (width, height): (u32, u32)) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let start = |name: &&str| {
            Command::new(name)
                .args([
                    "--headless=new",
                    "--no-sandbox",
                    "--disable-gpu",
                    "--hide-scrollbars",
                ])
                .args([
                    "--remote-debugging-port=0",
                    "--no-first-run",
                    "--force-color-profile=srgb",
                ])
                .arg(format!("--user-data-dir={}", profile.path().display()))
                .arg(format!("--window-size={width},{height}"))
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn()
                .ok()
        };
        let mut process = NAMES
            .iter()
            .find_map(start)
            .expect("install Chromium: these tests look at the page in a real browser");
        let mut lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| {
                line.strip_prefix("DevTools listening on ")
                    .map(str::to_owned)
            })
            .expect("the browser ended at once");
        // It must not stand still because nobody reads what else it says.
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(&address).unwrap();
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(SILENCE)).unwrap();
        }
        let mut browser = Self {
            process,
            _profile: profile,
            socket,
            session: String::new(),
            asked: 0,
            complaints: Vec::new(),
        };
        let target = browser.order("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = browser.order("Target.attachToTarget", attach);
        session["sessionId"]
            .as_str()
            .unwrap()
            .clone_into(&mut browser.session);
        browser.order("Runtime.enable", json!({}));
        browser.order("Page.enable", json!({}));
        browser.resize((width, height));
        browser.go(url);
        browser
    }

    /// Opens another page.
    pub fn go(&mut self, url: &str) {
        self.order("Page.navigate", json!({ "url": url }));
    }

    /// Runs a script in every page from now on, before its own.
    pub fn before(&mut self, script: &str) {
        let script = json!({ "source": script });
        self.order("Page.addScriptToEvaluateOnNewDocument", script);
    }

    fn order(&mut self, method: &str, parameters: Value) -> Value {
        let told = self.try_order(method, parameters);
        told.unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_order(&mut self, method: &str, parameters: Value) -> Result<Value, Value> {
        self.asked += 1;
        let mut order = json!({ "id": self.asked, "method": method, "params": parameters });
        if !self.session.is_empty() {
            order["sessionId"] = self.session.clone().into();
        }
        self.socket.send(Message::text(order.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let told: Value = serde_json::from_str(&text).unwrap();
            if told["id"] == self.asked {
                return match told.get("error") {
                    Some(error) => Err(error.clone()),
                    None => Ok(told["result"].clone()),
                };
            }
            self.note(&told);
        }
    }

    fn note(&mut self, told: &Value) {
        let is_error = told["params"]["type"] == "error";
        match told["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.complaints.push(told["params"].to_string()),
            Some("Runtime.consoleAPICalled") if is_error => {
                self.complaints.push(told["params"].to_string());
            }
            _ => {}
        }
    }

    /// What an expression is in the page; a promise is waited for.
    #[track_caller]
    pub fn ask(&mut self, expression: &str) -> Value {
        let told = self.evaluate(expression);
        told.unwrap_or_else(|error| panic!("{expression}: {error}"))
    }

    /// What an expression is in the page, if the page stays long enough to say so.
    #[track_caller]
    fn evaluate(&mut self, expression: &str) -> Result<Value, Value> {
        let question =
            json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let told = self.try_order("Runtime.evaluate", question)?;
        assert!(
            told.get("exceptionDetails").is_none(),
            "{expression}: {told}"
        );
        Ok(told["result"]["value"].clone())
    }

    /// Waits until a condition holds in the page, or in the one that comes after it: a click may lead to
    /// another page just now.
    #[track_caller]
    pub fn wait(&mut self, condition: &str) {
        let promise = format!(
            "new Promise((done) => {{ const begun = performance.now(); const look = () => {{ let holds = false; \
             try {{ holds = Boolean({condition}); }} catch {{ /* not there yet */ }} \
             if (holds) done(true); else if (performance.now() - begun > {PATIENCE_MS}) done(false); \
             else setTimeout(look, 15); }}; look(); }})"
        );
        let left = |error: &Value| {
            let said = error.to_string();
            said.contains("navigated") || said.contains("context")
        };
        let held = match self.evaluate(&promise) {
            Err(error) if left(&error) => self.ask(&promise),
            held => held.unwrap_or_else(|error| panic!("{condition}: {error}")),
        };
        if held != Value::Bool(true) {
            let seen = self.ask("document.body.innerText");
            panic!("never: {condition}\n{seen}\n{:?}", self.complaints);
        }
    }

    /// Clicks on the one button with this text, as a person does.
    #[track_caller]
    pub fn click(&mut self, text: &str) {
        let find = format!(
            "[...document.querySelectorAll('button')].find((one) => one.textContent === {text:?} && !one.disabled)"
        );
        self.wait(&find);
        self.ask(&format!("{find}.click()"));
    }

    /// The middle of an element, px.
    #[track_caller]
    fn middle(&mut self, selector: &str) -> (f64, f64) {
        let middle = format!(
            "(() => {{ const box = document.querySelector({selector:?}).getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        );
        let middle = self.ask(&middle);
        (middle[0].as_f64().unwrap(), middle[1].as_f64().unwrap())
    }

    fn mouse(&mut self, kind: &str, buttons: u8, (x, y): (f64, f64)) {
        let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1 });
        self.order("Input.dispatchMouseEvent", event);
    }

    /// Presses the mouse on an element, or lets it go there.
    #[track_caller]
    pub fn press(&mut self, selector: &str, pressed: bool) {
        let scrolled =
            format!("document.querySelector({selector:?}).scrollIntoView({{ block: 'center' }})");
        self.ask(&scrolled);
        let at = self.middle(selector);
        match pressed {
            true => self.mouse("mousePressed", 1, at),
            false => self.mouse("mouseReleased", 0, at),
        }
    }

    /// Drags what is at the middle of an element by so many px, with a mouse.
    #[track_caller]
    pub fn drag(&mut self, selector: &str, (dx, dy): (f64, f64)) {
        let at = self.pull(selector, (dx, dy));
        self.let_go(at);
    }

    /// Takes hold of the middle of an element and draws it by so many px, with a mouse that stays pressed; where it is then.
    #[track_caller]
    pub fn pull(&mut self, selector: &str, (dx, dy): (f64, f64)) -> (f64, f64) {
        let (x, y) = self.middle(selector);
        self.mouse("mousePressed", 1, (x, y));
        self.mouse("mouseMoved", 1, (x + dx / 2.0, y + dy / 2.0));
        self.mouse("mouseMoved", 1, (x + dx, y + dy));
        (x + dx, y + dy)
    }

    /// Lets go of what the mouse holds there.
    pub fn let_go(&mut self, at: (f64, f64)) {
        self.mouse("mouseReleased", 0, at);
    }

    /// Clicks at a point of an element, px from its upper left corner, with a mouse.
    #[track_caller]
    pub fn click_at(&mut self, selector: &str, (dx, dy): (f64, f64)) {
        let corner = format!(
            "(() => {{ const box = document.querySelector({selector:?}).getBoundingClientRect(); return [box.x, box.y]; }})()"
        );
        let corner = self.ask(&corner);
        let (x, y) = (
            corner[0].as_f64().unwrap() + dx,
            corner[1].as_f64().unwrap() + dy,
        );
        for (kind, buttons) in [("mousePressed", 1), ("mouseReleased", 0)] {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1 });
            self.order("Input.dispatchMouseEvent", event);
        }
    }

    /// As seen by somebody who has told the system so: `prefers-color-scheme: dark`, for example.
    pub fn prefer(&mut self, features: &[(&str, &str)]) {
        let features: Vec<Value> = features
            .iter()
            .map(|(name, value)| json!({ "name": name, "value": value }))
            .collect();
        self.order(
            "Emulation.setEmulatedMedia",
            json!({ "features": features }),
        );
    }

    /// Gives the page so many px to be seen in.
    pub fn resize(&mut self, (width, height): (u32, u32)) {
        let metrics =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.order("Emulation.setDeviceMetricsOverride", metrics);
    }

    /// Takes a picture of what is seen.
    pub fn picture(&mut self, path: &Path) {
        let told = self.order("Page.captureScreenshot", json!({ "format": "png" }));
        let bytes = BASE64.decode(told["data"].as_str().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
