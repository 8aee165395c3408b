//! The full screen of `ctos top`.

use std::{io, time::Duration};

use ratatui::{
    Frame,
    crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers},
    layout::{Constraint, Layout},
    style::{Modifier, Style},
    text::Line,
    widgets::Paragraph,
};

use cli_common::{
    client::{Client, ClientError},
    remote, show,
    table::{self, fitted},
};

use crate::top::{
    Sort, TopArgs,
    model::{COLUMNS, Model, Sample},
};

/// Shows the app until the person leaves.
pub(super) fn run(args: &TopArgs, client: &mut Client) -> Result<(), ClientError> {
    let mut model = Model::new(args.sort);
    model.see(remote::view(client)?);
    let mut terminal = ratatui::init();
    let mut screen = Screen {
        scrolled: 0,
        gone: false,
    };
    // The first numbers come soon, the others in their time.
    let mut wait = Duration::from_millis(200).min(args.interval);
    let ended = loop {
        match screen.keys(
            wait,
            &mut model,
            terminal.size().map_or(24, |size| size.height),
        ) {
            Ok(Key::Leave) => break Ok(()),
            Ok(Key::Changed) => {}
            Ok(Key::None) => {
                wait = args.interval;
                if !screen.gone {
                    match remote::view(client) {
                        Ok(view) => model.see(view),
                        Err(ClientError::Unreachable { .. }) => screen.gone = true,
                        Err(error) => break Err(error),
                    }
                }
            }
            Err(_) => break Ok(()),
        }
        let sample = model.sample();
        let drawn = terminal.draw(|frame| screen.draw(frame, sample.as_ref(), model.sort));
        if drawn.is_err() {
            break Ok(());
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
    /// Rows above the first one that is shown.
    scrolled: usize,
    /// The app has ended; what it was like last stays on the screen.
    gone: bool,
}

impl Screen {
    /// Waits for a key, at most so long.
    fn keys(&mut self, wait: Duration, model: &mut Model, height: u16) -> io::Result<Key> {
        if !event::poll(wait)? {
            return Ok(Key::None);
        }
        let Event::Key(key) = event::read()? else {
            return Ok(Key::Changed);
        };
        if key.kind != KeyEventKind::Press {
            return Ok(Key::Changed);
        }
        let page = usize::from(height.saturating_sub(5)).max(1);
        match key.code {
            KeyCode::Esc | KeyCode::Char('q') => return Ok(Key::Leave),
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
                return Ok(Key::Leave);
            }
            KeyCode::Char('b') => model.sort = Sort::Busy,
            KeyCode::Char('m') => model.sort = Sort::Messages,
            KeyCode::Char('u') => model.sort = Sort::Queue,
            KeyCode::Char('w') => model.sort = Sort::Wait,
            KeyCode::Char('n') => model.sort = Sort::Name,
            KeyCode::Up => self.scrolled = self.scrolled.saturating_sub(1),
            KeyCode::Down => self.scrolled += 1,
            KeyCode::PageUp => self.scrolled = self.scrolled.saturating_sub(page),
            KeyCode::PageDown => self.scrolled += page,
            KeyCode::Home => self.scrolled = 0,
            _ => {}
        }
        Ok(Key::Changed)
    }

    fn draw(&mut self, frame: &mut Frame<'_>, sample: Option<&Sample>, sort: Sort) {
        let areas = Layout::vertical([
            Constraint::Length(2),
            Constraint::Length(1),
            Constraint::Min(0),
            Constraint::Length(1),
        ]);
        let [title, heads, rows, keys] = areas.areas(frame.area());
        let width = usize::from(frame.area().width);
        let Some(sample) = sample else {
            return;
        };
        let state = if self.gone { "ENDED · " } else { "" };
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let text = fitted(&format!("{state}{}", sample.title), width);
        frame.render_widget(Paragraph::new(Line::styled(text, bold)), title);
        let mut lines = table::lines(&COLUMNS, &sample.rows(), width).into_iter();
        let inverse = Style::new().add_modifier(Modifier::REVERSED);
        let head = format!("{:<width$}", lines.next().unwrap_or_default());
        frame.render_widget(Paragraph::new(Line::styled(head, inverse)), heads);
        let last = lines.len().saturating_sub(usize::from(rows.height));
        self.scrolled = self.scrolled.min(last);
        let shown: Vec<Line<'_>> = lines.skip(self.scrolled).map(Line::from).collect();
        frame.render_widget(Paragraph::new(shown), rows);
        frame.render_widget(Paragraph::new(keys_line(sort, width)), keys);
    }
}

fn keys_line(sort: Sort, width: usize) -> Line<'static> {
    let mark = |name: &str, of: Sort| {
        if sort == of {
            format!("[{name}]")
        } else {
            name.to_owned()
        }
    };
    let text = format!(
        "sort: {} {} {} {} {} · arrows scroll · q leaves",
        mark("b busy", Sort::Busy),
        mark("m messages", Sort::Messages),
        mark("u queue", Sort::Queue),
        mark("w wait", Sort::Wait),
        mark("n name", Sort::Name),
    );
    Line::styled(
        fitted(&text, width),
        Style::new().add_modifier(Modifier::DIM),
    )
}

#[cfg(test)]
mod tests {
    use ratatui::{Terminal, backend::TestBackend};

    use super::*;

    #[test]
    fn the_screen_shows_the_app_and_the_keys_at_any_size() {
        let sample = Sample {
            title: "cell · up · 12 s since the start · pid 1 · cell.toml".to_owned(),
            app: "cell".to_owned(),
            up_s: 12.0,
            tasks: Vec::new(),
        };
        for (width, height) in [(80, 24), (160, 50), (10, 3), (1, 1)] {
            let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
            let mut screen = Screen {
                scrolled: 100,
                gone: true,
            };
            terminal
                .draw(|frame| screen.draw(frame, Some(&sample), Sort::Queue))
                .unwrap();
            if height >= 24 {
                let shown = terminal.backend().to_string();
                assert!(shown.contains("ENDED · cell · up"), "{shown}");
                assert!(shown.contains("[u queue]"), "{shown}");
                assert!(shown.contains("MSG/S"), "{shown}");
            }
        }
    }
}
