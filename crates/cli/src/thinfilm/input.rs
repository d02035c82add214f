//! What the commands read: recipes, lists of angles, samples of wavelengths.

use bake_brdf::recipe::{self, Recipe};
use std::path::Path;
use terminal::Stop;

/// Most wavelengths of one spectrum.
const MOST_SAMPLES: usize = 1_000_000;
/// Most angles.
const MOST_ANGLES: usize = 10_000;

pub(crate) fn read(path: &Path, most: u64) -> Result<String, Stop> {
    use std::io::Read as _;
    let named = |why: String| Stop::BadInput(format!("{}: {why}", path.display()));
    let file = std::fs::File::open(path).map_err(|why| named(why.to_string()))?;
    let mut text = String::new();
    let length = file.take(most + 1).read_to_string(&mut text).map_err(|why| named(why.to_string()))?;
    if length as u64 > most { Err(named(format!("longer than {most} bytes"))) } else { Ok(text) }
}

pub(crate) fn read_recipe(path: &Path) -> Result<Recipe, Stop> {
    Recipe::from_json(&read(path, recipe::MAX_BYTES)?)
        .map_err(|why| Stop::BadInput(format!("{}: {why}", path.display())))
}

/// `0,30,60:90:10` as angles of incidence in degrees, in the order given.
pub(crate) fn angles_deg(list: &str) -> Result<Vec<f64>, Stop> {
    let refuse = |item: &str| {
        Stop::BadInput(format!(
            "--angles-deg: {item:?} is not an angle or FROM:TO:STEP in degrees; expected 0 to 90, at most {MOST_ANGLES} in all"
        ))
    };
    let number = |text: &str, item: &str| {
        text.trim().parse::<f64>().ok().filter(|x| (0.0..=90.0).contains(x)).ok_or_else(|| refuse(item))
    };
    let mut angles = Vec::new();
    for item in list.split(',') {
        match item.split(':').collect::<Vec<_>>().as_slice() {
            [one] => angles.push(number(one, item)?),
            [from, to, step] => {
                let (from, to, step) = (number(from, item)?, number(to, item)?, number(step, item)?);
                let steps = ((to - from) / step + 1e-9).floor();
                if !(step > 0.0 && (0.0..MOST_ANGLES as f64).contains(&steps)) {
                    return Err(refuse(item));
                }
                angles.extend((0..=steps as u32).map(|i| f64::from(i).mul_add(step, from).min(to)));
            }
            _ => return Err(refuse(item)),
        }
        if angles.len() > MOST_ANGLES {
            return Err(refuse(item));
        }
    }
    Ok(angles)
}

/// `--members`, where it is given.
pub(crate) fn members(members: u64) -> Result<u64, Stop> {
    let most = thinfilm::ensemble::MOST_MEMBERS;
    if (1..=most).contains(&members) {
        return Ok(members);
    }
    Err(Stop::BadInput(format!("--members: {members} is not a number of stacks; expected 1 to {most}")))
}

/// `A:B:N` as N values from A to B.
pub(crate) fn samples(flag: &str, unit: &str, text: &str) -> Result<Vec<f64>, Stop> {
    let refuse = || {
        Stop::BadInput(format!(
            "{flag}: {text:?} is not A:B:N; expected two numbers > 0 ({unit}) and a count from 1 to {MOST_SAMPLES}"
        ))
    };
    let parts: Vec<&str> = text.split(':').collect();
    let [from, to, count] = parts.as_slice() else { return Err(refuse()) };
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
    let (Some(from), Some(to), Ok(count)) = (number(from), number(to), count.trim().parse::<usize>()) else {
        return Err(refuse());
    };
    if !(1..=MOST_SAMPLES).contains(&count) {
        return Err(refuse());
    }
    let step = if count > 1 { (to - from) / (count - 1) as f64 } else { 0.0 };
    Ok((0..count).map(|i| if i + 1 == count && count > 1 { to } else { from + i as f64 * step }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wavelengths_include_both_ends() {
        let samples = |text| samples("--wavelengths-nm", "nm", text);
        assert_eq!(samples("400:700:4").unwrap(), [400.0, 500.0, 600.0, 700.0]);
        assert_eq!(samples("550:550:1").unwrap(), [550.0]);
    }

    #[test]
    fn nonsense_wavelengths_are_refused() {
        for text in
            ["", "400", "400:700", "0:700:4", "-1:700:4", "400:700:0", "400:700:1e9", "a:b:c", "400:inf:3"]
        {
            assert!(samples("--wavelengths-nm", "nm", text).is_err(), "{text}");
        }
    }

    #[test]
    fn angles_are_numbers_and_ranges() {
        assert_eq!(angles_deg("0,12.5,30:90:30").unwrap(), [0.0, 12.5, 30.0, 60.0, 90.0]);
        for text in ["", "91", "-1", "nan", "a", "0:90", "0:90:0", "90:0:10", "0:90:1e-9", "1,,2"] {
            assert!(angles_deg(text).is_err(), "{text}");
        }
    }
}
