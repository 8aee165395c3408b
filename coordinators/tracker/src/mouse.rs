//! The daemon of a 3-D mouse: leaves how it is deflected in a snapshot buffer, and calls back what is not said anew (SORMA technical
//! report, sections 2.2.7 and 2.2.8). What deflects it are messages; the daemon of a real mouse would read a line.

use std::time::Duration;

use ctos::{
    diagnostic::Finding,
    message::{Command, Message},
    registry::Registry,
    sync::{CyclicHandle, Tick},
    task::{Context, EventHandler, Handled, Phase},
    time::Instant,
};
use serde::Deserialize;
use sorma::snapshot::{Layout, Place, Writer};
use std::{cell::RefCell, rc::Rc};

use crate::wire::{DeflectMouse, MOUSE, SteerMouse};

/// The handler's name.
pub const HANDLER: &str = "tracker.spacemouse";

/// Records that the buffer keeps.
const SLOTS: usize = 16;

/// Arguments.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct MouseArgs {
    /// How often it writes, Hz.
    rate_hz: f64,
    /// A deflection that is not said anew within this time is called back, s.
    callback_s: f64,
}

impl Default for MouseArgs {
    fn default() -> Self {
        Self {
            rate_hz: 60.0,
            callback_s: 0.3,
        }
    }
}

/// Registers the handler.
pub(crate) fn register(registry: &mut Registry) {
    let handler = registry.handler(HANDLER, &[DeflectMouse::INFO, SteerMouse::INFO], |cx| {
        Ok(Mouse {
            args: cx.args()?,
            deflected: Rc::default(),
            cyclic: None,
        })
    });
    handler.checked_args::<MouseArgs>(|args, task, _, findings| {
        let all = [
            ("rate_hz", args.rate_hz, 1e3),
            ("callback_s", args.callback_s, 60.0),
        ];
        for (key, value, most) in all {
            if !(value > 0.0 && value <= most) {
                let place = task.args.locate(key).unwrap_or_else(|| task.place.clone());
                let finding = Finding::error(
                    "coordinators::tracker::mouse",
                    format!("`{key}` is {value}"),
                );
                let help = format!("give a number above 0, up to {most}");
                findings.push(finding.at(place).help(help));
            }
        }
    });
}

/// Nobody steers longer with one message, s.
const LONGEST: f64 = 10.0;

/// What was said last, and until when it counts.
type Deflected = Rc<RefCell<Option<(Instant, [f64; 6])>>>;

struct Mouse {
    args: MouseArgs,
    deflected: Deflected,
    cyclic: Option<CyclicHandle>,
}

impl Mouse {
    /// Is deflected so from now on, for so long, s.
    fn deflect(&self, now: Instant, numbers: [f64; 6], seconds: f64) -> Result<(), String> {
        let wrong = numbers
            .iter()
            .find(|number| !(-1.0..=1.0).contains(*number));
        if let Some(wrong) = wrong {
            return Err(format!(
                "a deflection goes from -1 to 1, and one is {wrong}"
            ));
        }
        if !(0.0..=LONGEST).contains(&seconds) {
            return Err(format!(
                "the mouse is deflected for {LONGEST} s at most, not for {seconds}"
            ));
        }
        *self.deflected.borrow_mut() = Some((now + Duration::from_secs_f64(seconds), numbers));
        Ok(())
    }
}

impl EventHandler for Mouse {
    async fn handle(&mut self, cx: &Context, message: Message) -> Handled {
        match message.command() {
            DeflectMouse::CODE => {
                let (DeflectMouse { numbers }, reply) = message.open::<DeflectMouse>()?;
                match self.deflect(cx.now(), numbers, self.args.callback_s) {
                    Ok(()) => reply.ok(()),
                    Err(why) => reply.fail(why),
                }
            }
            SteerMouse::CODE => {
                let (steer, reply) = message.open::<SteerMouse>()?;
                let SteerMouse { x, y, z, .. } = steer;
                let numbers = [x, y, z, steer.about_x, steer.about_y, steer.about_z];
                match self.deflect(cx.now(), numbers, steer.seconds) {
                    Ok(()) => reply.ok(()),
                    Err(why) => reply.fail(why),
                }
            }
            _ => cx.default_processing(message),
        }
    }

    async fn phase(&mut self, cx: &Context, phase: Phase) -> Handled {
        if phase != Phase::Run {
            return Ok(());
        }
        let place = Place::of_app(&cx.app().name)?;
        let layout = Layout::new(SLOTS, 6).described("x\ny\nz\nabout x\nabout y\nabout z");
        let mut writer = Writer::create(&place, MOUSE, layout, cx.chassis().clock())?;
        let deflected = Rc::clone(&self.deflected);
        let tick = move |tick: &Tick| {
            let mut deflected = deflected.borrow_mut();
            if let Some((until, numbers)) = *deflected
                && tick.now > until
            {
                if numbers.iter().any(|number| *number != 0.0) {
                    tracing::warn!("a deflection that is not said anew is called back");
                }
                *deflected = None;
            }
            let numbers = deflected.map_or([0.0; 6], |(_, numbers)| numbers);
            let _ = writer.write(&numbers, &[]);
        };
        let period = Duration::from_secs_f64(1.0 / self.args.rate_hz);
        self.cyclic = Some(cx.cyclic(period, tick));
        Ok(())
    }
}
