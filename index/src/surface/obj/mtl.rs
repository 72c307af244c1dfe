//! Material libraries of OBJ files: `newmtl`, `Kd`, `map_Kd`, `d` and `Tr`.

use std::path::Path;

use super::super::lines::Lines;
use crate::import::tiles3d::ContentError;
use crate::orthoview::texture::linear;

/// Most materials of a library.
const MAX_MATERIALS: usize = 1 << 20;

/// A material as a library has it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) name: String,
    /// Linear light.
    pub(super) base: [f32; 3],
    /// The image's file as it is written.
    pub(super) image: Option<String>,
}

/// Reads a library. Colours are sRGB; a black one with an image is white, as exporters mean it.
pub(super) fn read(path: &Path) -> Result<Vec<Look>, ContentError> {
    let mut lines = Lines::open(path, 0, 0)?;
    let mut looks: Vec<Look> = Vec::new();
    while let Some(line) = lines.next()? {
        let line = line.trim_start();
        let (keyword, rest) = line.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            if looks.len() >= MAX_MATERIALS {
                return Err(lines.fault(format!("more than {MAX_MATERIALS} materials; expected at most that")));
            }
            looks.push(Look { name: rest.to_owned(), base: [1.0; 3], image: None });
            continue;
        }
        let Some(look) = looks.last_mut() else { continue };
        match keyword {
            "Kd" => {
                let mut numbers = rest.split_ascii_whitespace().map(str::parse::<f32>);
                let mut next = || numbers.next().and_then(Result::ok).filter(|v| v.is_finite());
                // One number stands for all three; spectral curves and XYZ are not read.
                if let Some(first) = next() {
                    look.base = [first, next().unwrap_or(first), next().unwrap_or(first)].map(light);
                }
            }
            "map_Kd" => look.image = image(rest),
            _ => {}
        }
    }
    for look in &mut looks {
        if look.image.is_some() && look.base == [0.0; 3] {
            look.base = [1.0; 3];
        }
    }
    Ok(looks)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
fn light(colour: f32) -> f32 {
    linear((colour.clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// The file behind the options of a map.
fn image(text: &str) -> Option<String> {
    let mut rest = text.trim_start();
    while let Some(option) = rest.strip_prefix('-') {
        let (name, after) = option.split_once(|c: char| c.is_ascii_whitespace())?;
        let most = match name {
            "o" | "s" | "t" => 3,
            "mm" => 2,
            _ => 1,
        };
        rest = after.trim_start();
        for taken in 0..most {
            let (value, after) = rest.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((rest, ""));
            // Offsets, scales and turbulence have one to three numbers.
            if taken > 0 && most == 3 && value.parse::<f64>().is_err() {
                break;
            }
            rest = after.trim_start();
        }
    }
    let name = rest.trim().replace('\\', "/");
    (!name.is_empty()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_stand_before_the_name() {
        for (text, name) in [
            ("wall.png", Some("wall.png")),
            ("-s 2 2 1 -o 0.5 red brick.png", Some("red brick.png")),
            ("-clamp on -mm 0 1 a\\b.jpg", Some("a/b.jpg")),
            ("-s 1", None),
            ("-s", None),
            ("", None),
        ] {
            assert_eq!(image(text).as_deref(), name, "{text:?}");
        }
    }
}
