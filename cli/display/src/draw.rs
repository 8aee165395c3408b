//! `ctos net draw`.

use std::path::{Path, PathBuf};

use clap::Args;
use ctos::diagnostic::Findings;
use pnt::{
    format,
    layout::{Detail, Drawing, LayoutFile},
    stream::{NetView, PinView, Side, State},
};

use cli_common::{exit, form::Form, show};

use crate::{figure::Figure, record::Recorded};

/// Draw a net, or a moment of a recorded one
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  ctos net draw configs/nets/dispatcher.net > dispatcher.svg
  ctos net draw run.ws1.mcap --net dispatcher --at 12.5 > fork.svg
  ctos net draw model.pnml --to dot | dot -Tpdf > model.pdf")]
pub struct DrawArgs {
    /// A net in any form, or a record (MCAP) of an app that ran nets
    pub file: PathBuf,
    /// Which net of a record; needed only when there are several
    #[arg(long, value_name = "NET")]
    pub net: Option<String>,
    /// The moment of a record, s since the start of the app; its end when left out
    #[arg(long, value_name = "SECONDS", value_parser = moment)]
    pub at: Option<u64>,
    /// The form; what is no drawing is written as by `ctos net convert`
    #[arg(long, alias = "as", value_enum, value_name = "FORM", default_value_t)]
    pub to: Form,
    /// Draw the places and transitions of coordination structures too
    #[arg(long)]
    pub full: bool,
    /// Print one JSON object instead: nodes with their positions, arcs and the marking
    #[arg(long)]
    pub json: bool,
}

/// Seconds as ns.
pub(crate) fn moment(text: &str) -> Result<u64, String> {
    let wrong = || "write a moment in seconds, for example 12.5".to_owned();
    let seconds: f64 = text.trim_end_matches('s').parse().map_err(|_| wrong())?;
    let nanos = (seconds * 1e9).round();
    if (0.0..1e18).contains(&nanos) {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "it is within the range"
        )]
        Ok(nanos as u64)
    } else {
        Err(wrong())
    }
}

/// Runs the command; `write` writes the net of a file in a form that is no drawing.
#[must_use]
pub fn run(args: &DrawArgs, write: impl FnOnce(&Path, Form) -> u8) -> u8 {
    if !args.json && !args.to.is_drawing() {
        return write(&args.file, args.to);
    }
    let record = args
        .file
        .extension()
        .is_some_and(|extension| extension == "mcap");
    let found = if record {
        recorded(args)
    } else {
        written(&args.file).map_err(|findings| {
            show::findings(findings);
            exit::CONFIG
        })
    };
    let (view, state) = match found {
        Ok(found) => found,
        Err(code) => return code,
    };
    let detail = if args.full {
        Detail::Full
    } else {
        Detail::Written
    };
    let text = if args.json {
        let drawing = Drawing::new(&view, detail);
        serde_json::json!({ "net": view.name, "drawing": drawing, "state": state }).to_string()
    } else {
        figure(&view, &state, detail, args.to)
    };
    // A reader that went away has what it wanted.
    let _ = show::data(&text);
    exit::OK
}

/// A drawing of the net of a file, at its initial marking.
///
/// # Errors
/// What is wrong with the file.
pub fn drawing(path: &Path, form: Form) -> Result<String, Findings> {
    let (view, state) = written(path)?;
    Ok(figure(&view, &state, Detail::Written, form))
}

fn figure(view: &NetView, state: &State, detail: Detail, form: Form) -> String {
    let drawing = &Drawing::new(view, detail);
    let figure = Figure {
        view,
        drawing,
        state,
    };
    let text = match form {
        Form::Dot => figure.dot(),
        Form::Mermaid => figure.mermaid(),
        _ => figure.svg(),
    };
    text.trim_end().to_owned()
}

/// A net at its initial marking.
fn written(path: &Path) -> Result<(NetView, State), Findings> {
    let file = format::read(path)?;
    let net = file.compile()?;
    let mut view = NetView::new(&net);
    let positions = file
        .positions
        .places
        .iter()
        .chain(&file.positions.transitions);
    let pins = positions.map(|(name, [x, y])| {
        let pin = PinView {
            x: x.clamp(-1e6, 1e6).round() as i32,
            y: y.clamp(-1e6, 1e6).round() as i32,
            label: Side::Below,
            lying: false,
        };
        (name.clone(), pin)
    });
    view.pins = pins.collect();
    let mut findings = Findings::new();
    let layout = LayoutFile::of_net(path, &mut findings);
    show::findings(findings);
    if !layout.nodes.is_empty() {
        for name in layout.pin(&mut view) {
            show::say(&format!(
                "warning: the layout file draws `{name}`, which net `{}` does not have",
                view.name
            ));
        }
    }
    let state = State::initial(&view);
    Ok((view, state))
}

/// A net at a moment of a record.
fn recorded(args: &DrawArgs) -> Result<(NetView, State), u8> {
    let recorded = Recorded::read(std::slice::from_ref(&args.file)).map_err(|error| {
        show::say(&format!("error: {error}"));
        exit::CONFIG
    })?;
    for warning in &recorded.warnings {
        show::say(&format!("warning: {warning}"));
    }
    let names = || recorded.nets.keys().cloned().collect::<Vec<_>>().join(", ");
    let net = match &args.net {
        Some(name) => recorded.nets.get(name),
        None if recorded.nets.len() > 1 => {
            show::say(&format!(
                "error: several nets are in {}: {}; choose one with `--net`",
                args.file.display(),
                names()
            ));
            return Err(exit::USAGE);
        }
        None => recorded.nets.values().next(),
    };
    let Some(net) = net else {
        let wanted = args.net.as_deref().unwrap_or_default();
        show::say(&format!(
            "error: no net `{wanted}` is in {}; there are: {}",
            args.file.display(),
            names()
        ));
        return Err(exit::NO_SUCH_NAME);
    };
    let Some((state, _)) = net.at(args.at, 0) else {
        let (from, to) = net.span();
        show::say(&format!(
            "error: net `{}` is recorded from {:.3} s to {:.3} s",
            net.view.name,
            from as f64 / 1e9,
            to as f64 / 1e9
        ));
        return Err(exit::FAILED);
    };
    Ok((net.view.clone(), state))
}
