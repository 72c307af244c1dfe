//! How alike two pictures are, where the reference shows something.
//!
//! SSIM is that of Wang, Bovik, Sheikh and Simoncelli (2004): for the luma x of the picture and y of the reference, with
//! means, variances and covariance under a Gaussian window of 11 × 11 pixels and σ = 1.5,
//!
//! SSIM = (2 μx μy + C₁)(2 σxy + C₂) / ((μx² + μy² + C₁)(σx² + σy² + C₂)),  C₁ = (0.01·255)², C₂ = (0.03·255)²,
//!
//! averaged over the pixels that are not sky in the reference. Sky counts in no window either: weights are the Gaussian's
//! there, normalised over what is left. Luma is 0.299 R + 0.587 G + 0.114 B of the sRGB codes.
//!
//! PSNR = 10 log₁₀(255² / mean squared error) over the same pixels' three channels.
//!
//! `image-compare` 0.5 has an SSIM too, but takes *sums* of products over its windows of 64 pixels for variances, so that
//! C₂ weighs a 64th of what it ought to, and has no mask; a test shows it.

use crate::gpu::Picture;

/// The window reaches so many pixels to each side.
const REACH: usize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// How alike a picture and its reference are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Mean of the structural similarity, −1 to 1; 1 for equal pictures.
    pub ssim: f64,
    /// dB; ∞ for equal pictures.
    pub psnr_db: f64,
    /// Share of the picture's pixels that were compared: the rest is sky.
    pub compared: f64,
    /// Share of the compared pixels at which the picture shows nothing.
    pub holes: f64,
}

/// Why two pictures cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {picture:?} pixels against a reference of {reference:?}; expected equal sizes")]
pub struct SizesDiffer {
    /// Columns and rows.
    pub picture: [u32; 2],
    /// Columns and rows.
    pub reference: [u32; 2],
}

/// Compares a picture with its reference; `None` where that shows nothing at all.
///
/// # Errors
/// Sizes that differ.
pub fn compare(picture: &Picture, reference: &Picture) -> Result<Option<Likeness>, SizesDiffer> {
    let pixels = reference.size[0] as usize * reference.size[1] as usize;
    let whole = |p: &Picture| p.size == reference.size && p.rgba.len() == 4 * pixels && p.distance.len() == pixels;
    if !whole(picture) || !whole(reference) {
        return Err(SizesDiffer { picture: picture.size, reference: reference.size });
    }
    let mask: Vec<f64> = reference.distance.iter().map(|d| if d.is_finite() { 1.0 } else { 0.0 }).collect();
    let compared: f64 = mask.iter().sum();
    if compared == 0.0 {
        return Ok(None);
    }
    let (mut squares, mut holes) = (0.0, 0.0);
    for (i, &kept) in mask.iter().enumerate() {
        let channels = picture.rgba[4 * i..4 * i + 3].iter().zip(&reference.rgba[4 * i..4 * i + 3]);
        squares +=
            kept * channels.map(|(&a, &b)| (f64::from(a) - f64::from(b)) * (f64::from(a) - f64::from(b))).sum::<f64>();
        if !picture.distance[i].is_finite() {
            holes += kept;
        }
    }
    let error = squares / (3.0 * compared);
    let map = structural_similarity(&luma(picture), &luma(reference), &mask, reference.size[0] as usize);
    Ok(Some(Likeness {
        ssim: map.iter().zip(&mask).map(|(s, kept)| s * kept).sum::<f64>() / compared,
        psnr_db: if error > 0.0 { 10.0 * libm::log10(255.0 * 255.0 / error) } else { f64::INFINITY },
        compared: compared / pixels as f64,
        holes: holes / compared,
    }))
}

fn luma(picture: &Picture) -> Vec<f64> {
    let of = |p: &[u8]| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]);
    picture.rgba.chunks_exact(4).map(of).collect()
}

/// The similarity at every pixel; 1 where the window holds no pixel of the mask.
fn structural_similarity(x: &[f64], y: &[f64], mask: &[f64], columns: usize) -> Vec<f64> {
    let window = window();
    let under = |field: &dyn Fn(usize) -> f64| {
        let field: Vec<f64> = mask.iter().enumerate().map(|(i, kept)| kept * field(i)).collect();
        blur(&field, columns, &window)
    };
    let weight = under(&|_| 1.0);
    let (mean_x, mean_y) = (under(&|i| x[i]), under(&|i| y[i]));
    let (xx, yy, xy) = (under(&|i| x[i] * x[i]), under(&|i| y[i] * y[i]), under(&|i| x[i] * y[i]));
    (0..mask.len())
        .map(|i| {
            if weight[i] <= 0.0 {
                return 1.0;
            }
            let of = |sum: &[f64]| sum[i] / weight[i];
            let (mx, my) = (of(&mean_x), of(&mean_y));
            let (vx, vy) = ((of(&xx) - mx * mx).max(0.0), (of(&yy) - my * my).max(0.0));
            let covariance = of(&xy) - mx * my;
            (2.0 * mx * my + C1) * (2.0 * covariance + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))
        })
        .collect()
}

/// One side of the Gaussian, from the middle outwards; not normalised, because the weights are.
fn window() -> [f64; REACH + 1] {
    core::array::from_fn(|i| libm::exp(-((i * i) as f64) / (2.0 * SIGMA * SIGMA)))
}

/// Convolved along rows, then along columns; nothing lies outside.
fn blur(field: &[f64], columns: usize, window: &[f64; REACH + 1]) -> Vec<f64> {
    let rows = field.len() / columns;
    let along = |from: &[f64], length: usize, place: &dyn Fn(usize) -> usize, at: usize| {
        let (first, last) = (at.saturating_sub(REACH), (at + REACH).min(length - 1));
        (first..=last).map(|j| window[j.abs_diff(at)] * from[place(j)]).sum::<f64>()
    };
    let mut by_rows = vec![0.0; field.len()];
    for (i, out) in by_rows.iter_mut().enumerate() {
        let (row, column) = (i / columns, i % columns);
        *out = along(field, columns, &|j| row * columns + j, column);
    }
    let mut out = vec![0.0; field.len()];
    for (i, out) in out.iter_mut().enumerate() {
        let (row, column) = (i / columns, i % columns);
        *out = along(&by_rows, rows, &|j| j * columns + column, row);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [48, 40];

    /// A grey picture, `sky` says where nothing is.
    fn picture(grey: impl Fn(u32, u32) -> u8, sky: impl Fn(u32, u32) -> bool) -> Picture {
        let at: Vec<_> = (0..SIZE[1]).flat_map(|row| (0..SIZE[0]).map(move |column| (column, row))).collect();
        Picture {
            size: SIZE,
            rgba: at.iter().flat_map(|&(c, r)| [grey(c, r), grey(c, r), grey(c, r), 255]).collect(),
            distance: at.iter().map(|&(c, r)| if sky(c, r) { f32::INFINITY } else { 7.0 }).collect(),
        }
    }

    fn noise(column: u32, row: u32) -> u8 {
        let mixed = (column.wrapping_mul(2_654_435_761) ^ row.wrapping_mul(40_503)).wrapping_mul(2_246_822_519);
        (mixed >> 24) as u8
    }

    fn nowhere(_: u32, _: u32) -> bool {
        false
    }

    #[test]
    fn equal_pictures_are_alike() {
        let p = picture(noise, nowhere);
        let likeness = compare(&p, &p).unwrap().unwrap();
        assert!((likeness.ssim - 1.0).abs() < 1e-12, "{likeness:?}");
        assert_eq!((likeness.psnr_db, likeness.compared, likeness.holes), (f64::INFINITY, 1.0, 0.0));
    }

    /// Two plain greys have no variance: SSIM = (2ab + C₁)/(a² + b² + C₁), and every pixel errs by |a − b|.
    #[test]
    fn plain_greys_have_a_closed_form() {
        for (a, b) in [(0, 5), (100, 110), (255, 0)] {
            let likeness = compare(&picture(|_, _| a, nowhere), &picture(|_, _| b, nowhere)).unwrap().unwrap();
            let (x, y) = (f64::from(a), f64::from(b));
            assert!((likeness.ssim - (2.0 * x * y + C1) / (x * x + y * y + C1)).abs() < 1e-9, "{likeness:?}");
            assert!((likeness.psnr_db - 20.0 * libm::log10(255.0 / (x - y).abs())).abs() < 1e-9, "{likeness:?}");
        }
    }

    /// A window far wider than a chequerboard's squares sees mean m and variance a²: against one of amplitude b in step,
    /// SSIM = (2ab + C₂)/(a² + b² + C₂), and of the opposite step with the sign turned. The Gaussian falls short of
    /// averaging it away by less than 10⁻³.
    #[test]
    fn chequerboards_have_a_closed_form() {
        let board = |amplitude: i32| {
            move |c: u32, r: u32| (128 + if (c + r).is_multiple_of(2) { amplitude } else { -amplitude }) as u8
        };
        for (a, b) in [(20, 20), (20, 8), (6, 2), (12, -12), (30, -5)] {
            let likeness = compare(&picture(board(a), nowhere), &picture(board(b), nowhere)).unwrap().unwrap();
            let (x, y) = (f64::from(a), f64::from(b));
            let expected = (2.0 * x * y + C2) / (x * x + y * y + C2);
            assert!((likeness.ssim - expected).abs() < 5e-3, "{a} {b}: {} {expected}", likeness.ssim);
        }
    }

    /// The same boards, as `image-compare` has them: its windows' sums are 64 times their variances.
    #[test]
    fn the_library_takes_sums_for_variances() {
        let grey = |amplitude: i32| {
            image::GrayImage::from_fn(8, 8, |c, r| {
                image::Luma([(128 + if (c + r).is_multiple_of(2) { amplitude } else { -amplitude }) as u8])
            })
        };
        let found =
            image_compare::gray_similarity_structure(&image_compare::Algorithm::MSSIMSimple, &grey(6), &grey(2));
        let with = |c2: f64| (2.0 * 12.0 + c2) / (36.0 + 4.0 + c2);
        let found = found.unwrap().score;
        assert!((found - with(C2 / 64.0)).abs() < 1e-9 && (found - with(C2)).abs() > 0.1, "{found}");
    }

    /// What lies in the sky changes nothing, next to the border either; what is missing beneath it does.
    #[test]
    fn the_sky_is_left_out() {
        let sky = |_: u32, row: u32| row < 17;
        let reference = picture(noise, sky);
        let other = picture(|c, r| if sky(c, r) { 255 - noise(c, r) } else { noise(c, r) }, nowhere);
        let likeness = compare(&other, &reference).unwrap().unwrap();
        assert!((likeness.ssim - 1.0).abs() < 1e-12 && likeness.psnr_db == f64::INFINITY, "{likeness:?}");
        assert!((likeness.compared - 23.0 / 40.0).abs() < 1e-12);
        let holed = picture(|c, r| if c < 12 { 0 } else { noise(c, r) }, |c, r| sky(c, r) || c < 12);
        let likeness = compare(&holed, &reference).unwrap().unwrap();
        assert!(likeness.ssim < 0.85 && (likeness.holes - 0.25).abs() < 1e-12, "{likeness:?}");
        assert_eq!(compare(&reference, &picture(noise, |_, _| true)).unwrap(), None);
    }

    #[test]
    fn sizes_that_differ_are_refused() {
        let p = picture(noise, nowhere);
        let short = Picture { size: [SIZE[0], SIZE[1] - 1], ..p.clone() };
        assert!(compare(&p, &short).unwrap_err().to_string().contains("expected equal sizes"));
        assert!(compare(&short, &p).is_err());
    }
}
