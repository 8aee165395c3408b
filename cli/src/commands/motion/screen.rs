//! The full screen of `ctos motion`.

use std::{io, time::Duration};

use cli_common::{
    client::{Client, ClientError},
    show,
    table::fitted,
};
use ratatui::{
    Frame,
    crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers},
    layout::{Constraint, Layout},
    style::{Color, Modifier, Style},
    text::Line as Text,
    widgets::Paragraph,
};

use super::{
    MotionArgs,
    model::{Kind, Line, Sample},
};

/// Shows the manipulators until the person leaves.
pub(super) fn run(
    args: &MotionArgs,
    client: &mut Client,
    first: Sample,
) -> Result<(), ClientError> {
    let mut terminal = ratatui::init();
    let mut screen = Screen {
        sample: first,
        scrolled: 0,
        gone: false,
    };
    let ended = loop {
        if terminal.draw(|frame| screen.draw(frame)).is_err() {
            break Ok(());
        }
        match screen.keys(args.interval) {
            Ok(Key::Leave) | Err(_) => break Ok(()),
            Ok(Key::Changed) => {}
            Ok(Key::None) if screen.gone => {}
            Ok(Key::None) => match Sample::look(client, &args.names) {
                Ok(sample) => screen.sample = sample,
                Err(ClientError::Unreachable { .. }) => screen.gone = true,
                Err(error) => break Err(error),
            },
        }
    };
    ratatui::restore();
    if screen.gone {
        show::say("the app has ended");
    }
    ended
}

enum Key {
    Leave,
    Changed,
    None,
}

struct Screen {
    sample: Sample,
    /// Lines above the first one that is shown.
    scrolled: usize,
    /// The app has ended; what it was like last stays on the screen.
    gone: bool,
}

impl Screen {
    /// Waits for a key, at most so long.
    fn keys(&mut self, wait: Duration) -> io::Result<Key> {
        if !event::poll(wait)? {
            return Ok(Key::None);
        }
        let Event::Key(key) = event::read()? else {
            return Ok(Key::Changed);
        };
        if key.kind != KeyEventKind::Press {
            return Ok(Key::Changed);
        }
        match key.code {
            KeyCode::Esc | KeyCode::Char('q') => return Ok(Key::Leave),
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
                return Ok(Key::Leave);
            }
            KeyCode::Up => self.scrolled = self.scrolled.saturating_sub(1),
            KeyCode::Down => self.scrolled += 1,
            KeyCode::PageUp => self.scrolled = self.scrolled.saturating_sub(10),
            KeyCode::PageDown => self.scrolled += 10,
            KeyCode::Home => self.scrolled = 0,
            _ => {}
        }
        Ok(Key::Changed)
    }

    fn draw(&mut self, frame: &mut Frame<'_>) {
        let [rows, keys] =
            Layout::vertical([Constraint::Min(0), Constraint::Length(1)]).areas(frame.area());
        let width = usize::from(frame.area().width);
        let lines = self.sample.lines(width);
        let last = lines.len().saturating_sub(usize::from(rows.height));
        self.scrolled = self.scrolled.min(last);
        let shown: Vec<Text<'_>> = lines.into_iter().skip(self.scrolled).map(styled).collect();
        frame.render_widget(Paragraph::new(shown), rows);
        let state = if self.gone { "ENDED · " } else { "" };
        let text = fitted(&format!("{state}arrows scroll · Esc leaves"), width);
        let dim = Style::new().add_modifier(Modifier::DIM);
        frame.render_widget(Paragraph::new(Text::styled(text, dim)), keys);
    }
}

fn styled(line: Line) -> Text<'static> {
    let style = match line.kind {
        Kind::Plain => Style::new(),
        Kind::Title => Style::new().add_modifier(Modifier::BOLD),
        Kind::Wrong if show::colours() => Style::new().fg(Color::Red),
        Kind::Wrong => Style::new().add_modifier(Modifier::BOLD),
    };
    Text::styled(line.text, style)
}

#[cfg(test)]
mod tests {
    use ratatui::{Terminal, backend::TestBackend};

    use super::super::model::tests::sample;
    use super::*;

    #[test]
    fn the_screen_shows_the_manipulators_and_the_keys_at_any_size() {
        for (width, height) in [(100, 24), (160, 50), (10, 3), (1, 1)] {
            let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
            let mut screen = Screen {
                sample: sample(),
                scrolled: 100,
                gone: true,
            };
            terminal.draw(|frame| screen.draw(frame)).unwrap();
            if height >= 24 {
                let shown = terminal.backend().to_string();
                for part in ["left · motion", "last stop", "●", "no answer", "ENDED"] {
                    assert!(shown.contains(part), "{part}: {shown}");
                }
            }
        }
    }
}
