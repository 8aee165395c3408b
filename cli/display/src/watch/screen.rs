//! The full screen of `ctos display`: one net at a time, what runs and what is enabled, the last events, and
//! the neighbourhood of a transition in boxes.

use std::time::Duration;

use pnt::stream::{Standing, TransitionView};
use ratatui::{
    Frame,
    crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers},
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    text::{Line, Span},
    widgets::{Block, Paragraph},
};

use super::{
    hops::{self, Look},
    live::{Live, Nets},
};
use cli_common::show;

use crate::text;

/// How often the screen is drawn, at most.
const EVERY: Duration = Duration::from_millis(50);

/// Shows nets until the person leaves.
pub(super) fn run(nets: &mut Nets) {
    nets.complete();
    let mut screen = Screen::default();
    let mut terminal = ratatui::init();
    loop {
        nets.take_in(EVERY);
        if terminal.draw(|frame| screen.draw(frame, nets)).is_err() || !screen.keys(nets) {
            break;
        }
    }
    ratatui::restore();
    if nets.nets.values().all(|net| net.gone.is_some()) {
        show::say("the app has ended");
    }
}

#[derive(Default)]
struct Screen {
    net: usize,
    /// Which of the net's transitions is looked at; none: the one that does something.
    chosen: Option<usize>,
}

impl Screen {
    /// Takes in the keys that were pressed; whether the person stays.
    fn keys(&mut self, nets: &Nets) -> bool {
        while event::poll(Duration::ZERO).unwrap_or(false) {
            let Ok(Event::Key(key)) = event::read() else {
                continue;
            };
            if key.kind != KeyEventKind::Press {
                continue;
            }
            let count = nets.nets.len().max(1);
            match key.code {
                KeyCode::Esc | KeyCode::Char('q') => return false,
                KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
                    return false;
                }
                KeyCode::Tab | KeyCode::Right => {
                    self.net = (self.net + 1) % count;
                    self.chosen = None;
                }
                KeyCode::BackTab | KeyCode::Left => {
                    self.net = (self.net + count - 1) % count;
                    self.chosen = None;
                }
                KeyCode::Down => self.chosen = Some(self.chosen.map_or(0, |chosen| chosen + 1)),
                KeyCode::Up => self.chosen = self.chosen.and_then(|chosen| chosen.checked_sub(1)),
                _ => {}
            }
        }
        true
    }

    fn draw(&self, frame: &mut Frame<'_>, nets: &Nets) {
        let areas = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(1),
            Constraint::Fill(2),
            Constraint::Fill(3),
            Constraint::Length(1),
        ]);
        let [head, tabs, middle, around, foot] = areas.areas(frame.area());
        let bold = Style::new().add_modifier(Modifier::BOLD);
        frame.render_widget(Line::styled(nets.app.as_str(), bold), head);
        let names = nets
            .nets
            .iter()
            .enumerate()
            .flat_map(|(index, (name, net))| {
                let look = if index == self.net {
                    Style::new().add_modifier(Modifier::REVERSED)
                } else {
                    Style::new()
                };
                let gone = if net.gone.is_some() { " gone" } else { "" };
                [
                    Span::styled(format!(" {name}{gone} "), look),
                    Span::raw(" "),
                ]
            });
        frame.render_widget(Line::from_iter(names), tabs);
        frame.render_widget("tab the next net · ↑↓ choose a transition · q leave", foot);
        let Some(net) = nets.nets.values().nth(self.net) else {
            frame.render_widget("no net runs", middle);
            return;
        };
        let [left, right] =
            Layout::horizontal([Constraint::Percentage(45), Constraint::Percentage(55)])
                .areas(middle);
        let standings = text::standings(&net.view, net.state());
        self.standings(frame, left, net, &standings);
        events(frame, right, net);
        let chosen = self
            .chosen
            .map_or(0, |chosen| chosen.min(standings.len().saturating_sub(1)));
        let one = standings.get(chosen);
        let one =
            one.and_then(|(name, ..)| net.view.transitions.iter().find(|one| one.shown == *name));
        if let Some(one) = one {
            neighbourhood(frame, around, net, &standings, one);
        }
    }

    fn standings(
        &self,
        frame: &mut Frame<'_>,
        area: Rect,
        net: &Live,
        standings: &[(&str, Standing, String)],
    ) {
        let state = net.state();
        let mut lines = Vec::new();
        for (head, why) in [
            ("gone", &net.gone),
            ("stopped", &state.stopped),
            ("paused", &state.paused),
        ] {
            lines.extend(
                why.as_ref()
                    .map(|why| Line::from(format!("{head}: {why}")).fg_red()),
            );
        }
        let marked: Vec<String> = text::marked(&net.view, state)
            .map(|(place, tokens)| {
                if tokens == 1 {
                    place.to_owned()
                } else {
                    format!("{place}*{tokens}")
                }
            })
            .collect();
        lines.push(Line::from(format!("marked   {}", marked.join(" "))));
        if !net.view.data.is_empty() {
            let data = text::data(&net.view, state);
            lines.push(Line::from(format!("data     {data}")));
        }
        let progress = state.in_progress.iter().map(|symbol| format!("[{symbol}]"));
        let tape: Vec<String> = progress.chain(state.tape.iter().cloned()).collect();
        if !net.view.commands.is_empty() {
            lines.push(Line::from(format!("tape     {}", tape.join(" "))));
        }
        if !net.breakpoints.is_empty() {
            lines.push(Line::from(format!(
                "breaks   {}",
                net.breakpoints.join(" ")
            )));
        }
        let stops = |shown: &str| {
            let mut parts = net.view.transitions.iter().filter(|one| one.shown == shown);
            parts.any(|part| net.breakpoints.iter().any(|at| at == part.called()))
        };
        // What is chosen must be seen.
        let room = usize::from(area.height).saturating_sub(lines.len() + 2);
        let skipped = self
            .chosen
            .map_or(0, |chosen| (chosen + 1).saturating_sub(room));
        for (index, (name, standing, words)) in standings.iter().enumerate().skip(skipped) {
            let (mark, colour) = match standing {
                Standing::Running => ("▶", Color::Yellow),
                Standing::Enabled => ("●", Color::Green),
                Standing::Waiting => ("·", Color::Reset),
            };
            let mut look = Style::new().fg(colour);
            if self.chosen == Some(index) {
                look = look.add_modifier(Modifier::REVERSED);
            }
            lines.push(Line::from(vec![
                Span::styled(format!("{mark} {name}"), look),
                Span::styled(if stops(name) { " ■" } else { "" }, Color::Red),
                Span::raw(format!("  {words}")),
            ]));
        }
        let title = format!(" {} · event {} ", net.view.name, state.seq);
        frame.render_widget(
            Paragraph::new(lines).block(Block::bordered().title(title)),
            area,
        );
    }
}

trait Red {
    fn fg_red(self) -> Self;
}

impl Red for Line<'_> {
    fn fg_red(self) -> Self {
        self.style(Style::new().fg(Color::Red))
    }
}

fn events(frame: &mut Frame<'_>, area: Rect, net: &Live) {
    let room = usize::from(area.height).saturating_sub(2);
    let lines = net
        .events
        .iter()
        .rev()
        .take(room)
        .map(|event| Line::from(text::event_line(&net.view, event)));
    let block = Block::bordered().title(" events, latest first ");
    frame.render_widget(Paragraph::new(lines.collect::<Vec<_>>()).block(block), area);
}

/// The nodes around a transition, in boxes, with what it calls and where it stands in the title.
fn neighbourhood(
    frame: &mut Frame<'_>,
    area: Rect,
    net: &Live,
    standings: &[(&str, Standing, String)],
    one: &TransitionView,
) {
    let parts = net
        .view
        .transitions
        .iter()
        .filter(|other| other.shown == one.shown);
    let listed = [
        (
            "calls",
            (!one.target.is_empty()).then(|| one.target.clone()),
        ),
        ("asks", one.task.clone().filter(|_| one.part == "start")),
        ("reads", one.tape.clone()),
        ("when", one.when.clone()),
        ("writes", parts.clone().find_map(|part| part.write.clone())),
        (
            "in",
            Some(one.at.rsplit('/').next().unwrap_or_default().to_owned()),
        ),
    ];
    let facts = listed
        .into_iter()
        .filter_map(|(head, fact)| Some(format!("{head} {}", fact?)));
    let facts: Vec<String> = facts.collect();
    let block = Block::bordered().title(format!(" {} · {} ", one.shown, facts.join(" · ")));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let chosen = net
        .drawing
        .nodes
        .iter()
        .position(|node| node.name == one.shown);
    let Some(chosen) = chosen else { return };
    let standings = standings
        .iter()
        .map(|(name, standing, _)| (*name, *standing));
    let lines = hops::around(
        (&net.view, &net.drawing, net.state()),
        &standings.collect(),
        chosen,
        (usize::from(inner.width), usize::from(inner.height)),
    );
    let lines: Vec<Line<'_>> = lines.into_iter().map(styled).collect();
    frame.render_widget(Paragraph::new(lines).centered(), inner);
}

fn styled(pieces: Vec<hops::Piece>) -> Line<'static> {
    let span = |(text, look, chosen): hops::Piece| {
        let colour = match look {
            Look::Line => Color::DarkGray,
            Look::Place | Look::Waiting => Color::Reset,
            Look::Enabled => Color::Green,
            Look::Running => Color::Yellow,
        };
        let style = Style::new().fg(colour);
        let style = if chosen {
            style.add_modifier(Modifier::BOLD)
        } else {
            style
        };
        Span::styled(text, style)
    };
    pieces.into_iter().map(span).collect()
}
