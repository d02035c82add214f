//! What the commands read: lists of angles, samples of wavelengths.

use terminal::Stop;

/// Most wavelengths of one spectrum.
const MOST_SAMPLES: usize = 1_000_000;
/// Most angles.
const MOST_ANGLES: usize = 10_000;

/// `--angles-deg`, in the order given.
pub(crate) fn angles_deg(list: &str) -> Result<Vec<f64>, Stop> {
    terminal::angles_deg("--angles-deg", list, MOST_ANGLES)
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
}
