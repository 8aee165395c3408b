//! Watches the frames of one camera for what a camera does that lies: it freezes, repeats itself, jumps in time, changes its
//! size, goes black, or is covered. Knows no task and no clock.
//!
//! What could make a measurement wrong is an error; each is named within five frames.

use std::time::Duration;

use ctos::Blob;
use serde::Deserialize;

use crate::frame::{Doubt, Frame, PixelFormat};

/// How a camera is watched: `[vss.cameras.NAME.watch]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WatchArgs {
    /// Whether equal pixels are a fault. A camera without noise that sees a still scene has them.
    frozen: bool,
    /// A camera whose pictures are darker on average is black, grey levels; 0: none is.
    black_below: f64,
    /// A camera is covered in whose pictures no part is further off the mean, grey levels; 0: none is.
    covered_below: f64,
    /// A frame of a live source may be so much older when it comes than the one that came the soonest, s.
    oldest_s: f64,
}

impl Default for WatchArgs {
    fn default() -> Self {
        Self {
            frozen: true,
            black_below: 8.0,
            covered_below: 0.6,
            oldest_s: 2.0,
        }
    }
}

/// So many frames in a row must be black or even: one may be by chance.
const IN_A_ROW: u32 = 3;

/// How fast the age at which frames come the soonest may grow: the clocks of two hosts drift apart.
const DRIFT: f64 = 1e-3;

/// Parts of a picture along each side, whose mean greys are compared.
const PARTS: usize = 8;

/// What is kept of the frame before.
#[derive(Debug)]
struct Before {
    number: u64,
    stamp: Duration,
    pixels: Blob,
}

/// Watches one camera.
#[derive(Debug)]
pub struct Watch {
    args: WatchArgs,
    /// Whether the source's stamps are of the app's clock, and its pixels those of a sensor.
    live: bool,
    size: Option<(usize, usize, PixelFormat)>,
    before: Option<Before>,
    /// How old frames are that come the soonest, s, and when that was seen. By clocks of two hosts, which may differ by seconds.
    soonest: Option<(f64, Duration)>,
    /// For how many frames pixels were black, even.
    black: u32,
    even: u32,
}

impl Watch {
    /// Watches one camera. `live` says whether its stamps are of the app's clock, and its pixels those of a sensor.
    #[must_use]
    pub fn new(args: WatchArgs, live: bool) -> Self {
        Self {
            args,
            live,
            size: None,
            before: None,
            soonest: None,
            black: 0,
            even: 0,
        }
    }

    /// What is wrong with the camera whose next frame, which came at `now`, this is: the first thing, in words.
    pub fn look(&mut self, frame: &Frame, now: Duration) -> Option<(Doubt, String)> {
        let found = self.numbers(frame, now);
        let pixels = self.pixels(frame);
        self.before = Some(Before {
            number: frame.number,
            stamp: frame.stamp,
            pixels: frame.pixels.clone(),
        });
        found.or(pixels)
    }

    fn numbers(&mut self, frame: &Frame, now: Duration) -> Option<(Doubt, String)> {
        let is = (frame.width, frame.height, frame.format);
        let was = *self.size.get_or_insert(is);
        if is != was || !frame.is_whole() {
            let say = |(width, height, format): (usize, usize, PixelFormat)| {
                format!("{width} x {height} px of {} bytes", format.bytes())
            };
            let bytes = frame.pixels.len();
            let text = format!(
                "its pictures were {}, and now are {} in {bytes} bytes",
                say(was),
                say(is)
            );
            return Some((Doubt::Size, text));
        }
        if let Some(before) = &self.before
            && frame.number <= before.number
        {
            let text = format!("frame {} comes after frame {}", frame.number, before.number);
            return Some((Doubt::Repeated, text));
        }
        if !self.live {
            return None;
        }
        let stamp = frame.stamp;
        let jump = |text: String| Some((Doubt::TimeJump, text));
        if let Some(before) = &self.before
            && stamp < before.stamp
        {
            return jump(format!(
                "its stamps go back from {:?} to {stamp:?}",
                before.stamp
            ));
        }
        let age = now.as_secs_f64() - stamp.as_secs_f64();
        let soonest = self.soonest.map_or(age, |(soonest, then)| {
            soonest + DRIFT * now.saturating_sub(then).as_secs_f64()
        });
        let late = age - soonest;
        if late.abs() > self.args.oldest_s + frame.exposure.as_secs_f64() {
            let way = if late > 0.0 { "later" } else { "sooner" };
            return jump(format!(
                "its stamp is {stamp:?}: it came {:.1} s {way} after that than others do",
                late.abs()
            ));
        }
        self.soonest = Some((soonest.min(age), now));
        None
    }

    fn pixels(&mut self, frame: &Frame) -> Option<(Doubt, String)> {
        if !self.live {
            return None;
        }
        let same = self
            .before
            .as_ref()
            .is_some_and(|before| before.pixels == frame.pixels);
        let count = |times: &mut u32, is: bool| *times = if is { *times + 1 } else { 0 };
        let (mean, spread) = evenness(frame);
        let black = mean < self.args.black_below;
        count(&mut self.black, black);
        count(&mut self.even, !black && spread < self.args.covered_below);
        if self.black >= IN_A_ROW {
            let text = format!("its pictures have a mean of {mean:.1} grey levels");
            return Some((Doubt::Black, text));
        }
        if self.even >= IN_A_ROW {
            let text = format!(
                "its pictures are one grey: {mean:.1} grey levels, parts of it within {spread:.2} of that"
            );
            return Some((Doubt::Covered, text));
        }
        // No sensor gives the same noise twice, but in the dark it may give none.
        let text = || format!("frame {} has the pixels of the one before", frame.number);
        (same && !black && self.args.frozen).then(|| (Doubt::Frozen, text()))
    }
}

/// Of the means of 64 parts noise takes hardly one further, in standard deviations.
const SURE: f64 = 4.0;

/// The mean grey, and by how much the mean of a part is off it at most, less what noise may do.
fn evenness(frame: &Frame) -> (f64, f64) {
    let grey = frame.grey();
    let (width, height) = (frame.width, frame.height);
    if !frame.is_whole() || width < PARTS || height < PARTS {
        return (f64::INFINITY, f64::INFINITY);
    }
    let (mut sums, mut steps) = ([0_u64; PARTS * PARTS], 0_u64);
    let (across, down) = (width / PARTS, height / PARTS);
    for (row, line) in grey.chunks_exact(width).take(down * PARTS).enumerate() {
        for (part, pixels) in line.chunks_exact(across).take(PARTS).enumerate() {
            let sum: u64 = pixels.iter().map(|grey| u64::from(*grey)).sum();
            sums[row / down * PARTS + part] += sum;
            // Neighbours differ by the noise where there is no edge.
            let pairs = pixels.iter().zip(&pixels[1..]).step_by(8);
            steps += pairs
                .map(|(one, other)| u64::from(one.abs_diff(*other)).pow(2))
                .sum::<u64>();
        }
    }
    let area = (across * down) as f64;
    let counted = (PARTS * PARTS * down) as f64 * across.saturating_sub(1).div_ceil(8) as f64;
    let noise = if counted > 0.0 {
        steps as f64 / counted / 2.0
    } else {
        0.0
    };
    let means = sums.map(|sum| sum as f64 / area);
    let n = (PARTS * PARTS) as f64;
    let mean = means.iter().sum::<f64>() / n;
    let most = means.iter().map(|x| (x - mean).abs()).fold(0.0, f64::max);
    (mean, (most - SURE * (noise / area).sqrt()).max(0.0))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const PERIOD: Duration = Duration::from_millis(40);

    /// What a camera makes of a good frame, by its number.
    type Lie = dyn Fn(u64, Frame) -> Frame;

    /// Frame `number` of a good camera: a bright half, and noise.
    fn good(number: u64) -> Frame {
        picture(number, |u| if u < 32 { 40.0 } else { 70.0 })
    }

    fn picture(number: u64, grey: impl Fn(usize) -> f64) -> Frame {
        let mut rng = ChaCha8Rng::seed_from_u64(number);
        let pixels = (0..64 * 48).map(|k| (grey(k % 64) + rng.random_range(-6.0..6.0)) as u8);
        Frame {
            number,
            stamp: PERIOD * u32::try_from(number).unwrap(),
            ..Frame::grey8(64, 48, pixels.collect::<Vec<u8>>())
        }
    }

    /// After how many frames what `lie` makes of good ones is noticed, and as what.
    fn noticed(live: bool, lie: impl Fn(u64, Frame) -> Frame) -> Option<(u64, Doubt)> {
        let mut watch = Watch::new(WatchArgs::default(), live);
        for number in 0..20 {
            let frame = good(number);
            let now = frame.stamp + Duration::from_millis(3);
            assert_eq!(watch.look(&frame, now), None, "{number}");
        }
        (20..40).find_map(|number| {
            let frame = lie(number, good(number));
            let now = PERIOD * u32::try_from(number).unwrap() + Duration::from_millis(3);
            let (doubt, _) = watch.look(&frame, now)?;
            Some((number - 19, doubt))
        })
    }

    #[test]
    fn each_lie_is_named_within_five_frames_and_a_good_camera_never() {
        assert_eq!(noticed(true, |_, frame| frame), None);
        let lies: [(Doubt, &Lie); 9] = [
            (Doubt::Frozen, &|_, frame| Frame {
                pixels: good(19).pixels,
                ..frame
            }),
            (Doubt::Repeated, &|_, _| good(19)),
            (Doubt::Repeated, &|_, frame| Frame { number: 3, ..frame }),
            (Doubt::TimeJump, &|_, frame| Frame {
                stamp: Duration::ZERO,
                ..frame
            }),
            (Doubt::TimeJump, &|_, frame| Frame {
                stamp: frame.stamp + Duration::from_secs(60),
                ..frame
            }),
            (Doubt::Size, &|_, frame| Frame {
                width: 48,
                height: 64,
                ..frame
            }),
            (Doubt::Size, &|_, frame| Frame {
                format: PixelFormat::Rgb8,
                ..frame
            }),
            (Doubt::Black, &|number, _| picture(number, |_| 0.0)),
            (Doubt::Covered, &|number, _| picture(number, |_| 30.0)),
        ];
        for (doubt, lie) in lies {
            let (frames, named) = noticed(true, lie).unwrap();
            assert!(
                named == doubt && frames <= 5,
                "{doubt:?}: {named:?} after {frames}"
            );
        }
        // A source that goes on slower than time, or stands: its frames become too old.
        let old = |number: u64, frame: Frame| {
            let late = PERIOD * u32::try_from(number - 19).unwrap() * 20;
            Frame {
                stamp: frame.stamp.saturating_sub(late).max(good(19).stamp),
                ..frame
            }
        };
        let mut watch = Watch::new(WatchArgs::default(), true);
        assert_eq!(watch.look(&good(19), good(19).stamp), None);
        let seen = watch.look(&old(22, good(22)), Duration::from_secs(4));
        assert_eq!(seen.map(|seen| seen.0), Some(Doubt::TimeJump));
    }

    #[test]
    fn a_camera_whose_clock_differs_and_drifts_is_believed_for_hours() {
        for ahead in [-10.0, 10.0] {
            for rate in [1.0 - 2e-4, 1.0 + 2e-4] {
                let mut watch = Watch::new(WatchArgs::default(), true);
                for number in 0..10_000_u64 {
                    // A frame each two seconds, which comes up to a second late.
                    let now = 100.0 + 2.0 * number as f64;
                    let late = (number % 7) as f64 / 7.0;
                    let frame = Frame {
                        stamp: Duration::from_secs_f64((now - late) * rate + ahead),
                        ..good(number)
                    };
                    let seen = watch.look(&frame, Duration::from_secs_f64(now));
                    assert_eq!(seen, None, "{number}");
                }
            }
        }
    }

    #[test]
    fn one_frame_that_is_black_or_even_by_chance_is_no_fault() {
        let mut watch = Watch::new(WatchArgs::default(), true);
        for number in 0..30 {
            let frame = match number % 3 {
                0 => picture(number, |_| 0.0),
                1 => picture(number, |_| 30.0),
                _ => good(number),
            };
            assert_eq!(watch.look(&frame, frame.stamp), None, "{number}");
        }
    }

    #[test]
    fn of_pictures_from_files_stamps_and_pixels_say_nothing() {
        let file = |number: u64, _: Frame| Frame { number, ..good(3) };
        assert_eq!(noticed(false, file), None);
        let (_, named) = noticed(false, |_, _| good(3)).unwrap();
        assert_eq!(named, Doubt::Repeated);
        let (_, named) = noticed(false, |number, _| Frame {
            number,
            ..Frame::grey8(2, 2, vec![0; 4])
        })
        .unwrap();
        assert_eq!(named, Doubt::Size);
    }

    #[test]
    fn a_camera_that_is_well_again_is_believed_again() {
        let mut watch = Watch::new(WatchArgs::default(), true);
        for number in 0..8 {
            watch.look(
                &picture(number, |_| 0.0),
                PERIOD * u32::try_from(number).unwrap(),
            );
        }
        let frame = good(8);
        assert_eq!(watch.look(&frame, frame.stamp), None);
    }
}
