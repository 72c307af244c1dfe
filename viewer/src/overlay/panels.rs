//! The panels.

use super::colours::FalseColour;
use super::{Facts, Look};
use crate::controls::bindings::BINDINGS;
use crate::controls::rig::Mode;
use crate::exchange::Link;
use crate::gpu::SplatShape;
use egui::{Align2, Color32, Context, Frame, Grid, RichText, Slider, Ui, Window, pos2, vec2};

/// What is listed of what is on its way.
const LISTED: usize = 6;

const WARNING: Color32 = Color32::from_rgb(255, 190, 90);

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

fn quality(value: Option<f64>) -> String {
    value.map_or("nothing in view".to_owned(), |value| format!("{value:.3}"))
}

/// Draws the panels, and changes `look` as people there say.
pub fn show(context: &Context, facts: &Facts, look: &mut Look) {
    notices(context, facts);
    credits(context, facts);
    if !look.panels {
        return;
    }
    let frame = Frame::window(&context.style_of(context.theme())).fill(Color32::from_black_alpha(190));
    Window::new("foresight").frame(frame).anchor(Align2::LEFT_TOP, vec2(8.0, 8.0)).resizable(false).show(
        context,
        |ui| {
            ui.set_max_width(330.0);
            figures(ui, facts);
            ui.separator();
            fetching(ui, facts);
        },
    );
    Window::new("picture").frame(frame).anchor(Align2::RIGHT_TOP, vec2(-8.0, 8.0)).resizable(false).show(
        context,
        |ui| {
            ui.set_max_width(240.0);
            settings(ui, look);
        },
    );
    if look.keys {
        Window::new("keys")
            .frame(frame)
            .anchor(Align2::CENTER_CENTER, vec2(0.0, 40.0))
            .resizable(false)
            .show(context, keys);
    }
}

fn figures(ui: &mut Ui, facts: &Facts) {
    let status = &facts.status;
    let (sum, count) = (facts.frames_s.iter().sum::<f32>(), facts.frames_s.len());
    let mean_ms = if count > 0 { 1000.0 * sum / count as f32 } else { 0.0 };
    let slowest_ms = facts.frames_s.iter().fold(0.0_f32, |a, &b| a.max(b)) * 1000.0;
    Grid::new("figures").num_columns(2).spacing([12.0, 2.0]).show(ui, |ui| {
        let mut row = |name: &str, value: String| {
            ui.label(name);
            ui.label(RichText::new(value).strong());
            ui.end_row();
        };
        row("frame", format!("{mean_ms:.1} ms, slowest {slowest_ms:.0} ms"));
        row("quality planned", quality(status.quality));
        row("quality shown", quality(facts.shown_quality));
        row("bandwidth", {
            let estimate = status
                .estimate
                .map(|(rate, latency)| format!(", link about {:.1} Mbit/s, {:.0} ms", rate * 8e-6, latency * 1e3));
            format!("{:.2} Mbit/s{}", facts.rate * 8e-6, estimate.unwrap_or_default())
        });
        row("received", megabytes(status.received));
        row("memory planned", format!("{} of {}", megabytes(status.memory), megabytes(status.budget)));
        let used = facts.used;
        row(
            "memory used",
            format!(
                "{}: GPU {:.1}, decoded {:.1}, wire {:.1}",
                megabytes(used.total()),
                used.gpu as f64 / 1e6,
                used.decoded as f64 / 1e6,
                used.wire as f64 / 1e6
            ),
        );
        let counts = facts.counts;
        row("drawn", format!("{} points, {} triangles", counts.points, counts.triangles));
        row("", format!("{} contents, {} stand in, bias {:.2}", facts.items, facts.substitutes, facts.bias));
        if let Some(maps) = &facts.maps {
            let points = counts.map_points;
            row("maps", format!("{} drawn for {} contents, {points} points", maps.maps_drawn, maps.left_out));
            row("", format!("{} of 48 faces, {} made, {}", maps.faces, maps.maps_made, megabytes(maps.bytes)));
        }
        let mode = match facts.mode {
            Some(Mode::Walk) => "walking",
            Some(Mode::Orbit) => "orbiting",
            _ => "flying",
        };
        row("camera", format!("{mode}, {:.1} m/s", facts.speed));
        let p = facts.position;
        row("", format!("{:.1}  {:.1}  {:.1} m", p.x, p.y, p.z));
        if let Some((at, length)) = facts.playing {
            row("path", format!("{at:.1} of {length:.1} s"));
        }
        if let Some(seconds) = facts.recording {
            row("recording", format!("{seconds:.1} s"));
        }
        row("policy", status.policy.clone());
        row("adapter", facts.adapter.clone());
    });
    history(ui, facts);
}

/// Times of the latest frames as bars, with a line at 1/30 s.
fn history(ui: &mut Ui, facts: &Facts) {
    let (response, painter) = ui.allocate_painter(vec2(ui.available_width().min(310.0), 28.0), egui::Sense::hover());
    let area = response.rect;
    let most = facts.frames_s.iter().fold(1.0_f32 / 30.0, |a, &b| a.max(b)) * 1.1;
    let width = area.width() / facts.frames_s.len().max(1) as f32;
    for (i, &seconds) in facts.frames_s.iter().enumerate() {
        let x = area.left() + width * i as f32;
        let top = area.bottom() - area.height() * (seconds / most).min(1.0);
        let bar = egui::Rect::from_min_max(pos2(x, top), pos2(x + (width - 0.5).max(0.5), area.bottom()));
        painter.rect_filled(bar, 0.0, Color32::from_rgb(110, 170, 230));
    }
    let y = area.bottom() - area.height() / (30.0 * most);
    painter.hline(area.x_range(), y, (1.0, Color32::from_white_alpha(90)));
}

fn fetching(ui: &mut Ui, facts: &Facts) {
    let status = &facts.status;
    if status.fetching.is_empty() {
        ui.label(match &status.waiting {
            Some(because) => format!("nothing is fetched: {because}"),
            None => "nothing is fetched".to_owned(),
        });
    } else {
        ui.label(format!("{} on their way:", status.fetching.len()));
    }
    for (one, address) in status.fetching.iter().zip(&facts.addresses).take(LISTED) {
        let share = if one.bytes > 0 { 100.0 * one.received as f64 / one.bytes as f64 } else { 0.0 };
        ui.label(RichText::new(format!("{address}  {:.0} kB, {share:.0} %", one.bytes as f64 / 1e3)).small());
        ui.label(RichText::new(format!("    {}", one.why)).small().weak());
    }
    if facts.pending > 0 {
        ui.label(format!("{} wait to be decoded or uploaded", facts.pending));
    }
    if let Some(failure) = status.failure.as_ref().filter(|_| status.failed > 0) {
        ui.colored_label(WARNING, format!("{} failed", status.failed)).on_hover_text(failure);
    }
}

fn settings(ui: &mut Ui, look: &mut Look) {
    ui.label("false colours [C]");
    ui.horizontal_wrapped(|ui| {
        for one in FalseColour::ALL {
            ui.selectable_value(&mut look.false_colour, one, one.name());
        }
    });
    if let Some((ends, colours)) = look.false_colour.legend() {
        ui.horizontal(|ui| {
            ui.label(RichText::new(&ends[0]).small());
            for [r, g, b] in colours {
                let (rect, _) = ui.allocate_exact_size(vec2(10.0, 10.0), egui::Sense::hover());
                ui.painter().rect_filled(rect, 0.0, Color32::from_rgb(r, g, b));
            }
            ui.label(RichText::new(&ends[1]).small());
        });
    }
    ui.label("splats [V]");
    ui.horizontal_wrapped(|ui| {
        for shape in SplatShape::ALL {
            ui.selectable_value(&mut look.shape, shape, shape.name());
        }
    });
    ui.checkbox(&mut look.lit, "light from the normals [L]");
    ui.add_enabled(look.lit, Slider::new(&mut look.sun[0], 0.0..=360.0).suffix("°").text("around [,]"));
    ui.add_enabled(look.lit, Slider::new(&mut look.sun[1], 0.0..=90.0).suffix("°").text("above [.]"));
    ui.add_enabled(look.lit, Slider::new(&mut look.ambient, 0.0..=1.0).text("from everywhere"));
    ui.checkbox(&mut look.smooth, "antialiasing [M]");
    ui.checkbox(&mut look.holds_time, "draw less where a frame takes too long [T]");
    ui.checkbox(&mut look.maps, "far things from environment maps [N]");
    ui.checkbox(&mut look.keys, "keys [H]");
}

fn keys(ui: &mut Ui) {
    let rows = BINDINGS.len().div_ceil(2);
    Grid::new("keys").num_columns(4).spacing([10.0, 0.0]).show(ui, |ui| {
        for row in 0..rows {
            for binding in [BINDINGS.get(row), BINDINGS.get(row + rows)].into_iter().flatten() {
                ui.label(RichText::new(binding.label).small().strong());
                ui.label(RichText::new(binding.what).small());
            }
            ui.end_row();
        }
    });
}

/// What is to be known at once, in the middle above.
fn notices(context: &Context, facts: &Facts) {
    let mut lines: Vec<String> = Vec::new();
    match &facts.status.link {
        Link::Away { why } => lines.push(format!("The server is away: connecting again … ({why})")),
        Link::Over(why) => lines.push(format!("No more is fetched: {why}")),
        Link::InProcess | Link::Connected => {}
    }
    lines.extend(facts.notices.iter().cloned());
    if lines.is_empty() {
        return;
    }
    egui::Area::new(egui::Id::unique("notices")).anchor(Align2::CENTER_BOTTOM, vec2(0.0, -40.0)).show(context, |ui| {
        Frame::popup(ui.style()).fill(Color32::from_black_alpha(220)).show(ui, |ui| {
            ui.set_max_width(620.0);
            for line in lines {
                ui.colored_label(WARNING, line);
            }
        });
    });
}

fn credits(context: &Context, facts: &Facts) {
    if facts.credits.is_empty() {
        return;
    }
    let words: Vec<&str> = facts.credits.iter().map(|credit| &**credit).collect();
    egui::Area::new(egui::Id::unique("credits")).anchor(Align2::RIGHT_BOTTOM, vec2(-6.0, -6.0)).show(context, |ui| {
        Frame::NONE.fill(Color32::from_black_alpha(140)).inner_margin(3.0).show(ui, |ui| {
            ui.set_max_width(700.0);
            ui.label(RichText::new(words.join(" · ")).small().color(Color32::WHITE));
        });
    });
}
