//! Lists on the command line.

use crate::Stop;

/// `0,30,60:90:10`: angles of 0 to 90 degrees, at most `most`, in the order given. `flag` is what a refusal names.
///
/// # Errors
/// An item that is neither an angle nor FROM:TO:STEP, or too many angles: bad input.
pub fn angles_deg(flag: &str, list: &str, most: usize) -> Result<Vec<f64>, Stop> {
    let refuse = |item: &str| {
        Stop::bad_input(format!(
            "{flag}: {item:?} is not an angle or FROM:TO:STEP in degrees; expected 0 to 90, at most {most} in all"
        ))
    };
    let mut angles = Vec::new();
    for item in list.split(',') {
        let number = |text: &str| {
            text.trim().parse::<f64>().ok().filter(|x| (0.0..=90.0).contains(x)).ok_or_else(|| refuse(item))
        };
        match item.split(':').collect::<Vec<_>>().as_slice() {
            [one] => angles.push(number(one)?),
            [from, to, step] => {
                let (from, to, step) = (number(from)?, number(to)?, number(step)?);
                // A last step that rounding takes beyond TO is TO.
                let steps = ((to - from) / step + 1e-9).floor();
                if !(step > 0.0 && (0.0..most as f64).contains(&steps)) {
                    return Err(refuse(item));
                }
                angles.extend((0..=steps as u32).map(|i| (from + f64::from(i) * step).min(to)));
            }
            _ => return Err(refuse(item)),
        }
        if angles.len() > most {
            return Err(refuse(item));
        }
    }
    Ok(angles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_numbers_and_ranges_in_their_order() {
        let angles = |list| angles_deg("--angles-deg", list, 1000).unwrap();
        assert_eq!(angles("0,12.5,30:90:30"), [0.0, 12.5, 30.0, 60.0, 90.0]);
        assert_eq!(angles("90, 0"), [90.0, 0.0]);
        // 0.2 + 898·0.1 is 90.00000000000001.
        let fine = angles("0.2:90:0.1");
        assert_eq!((fine.len(), fine[898]), (899, 90.0));
    }

    #[test]
    fn what_is_no_angle_is_refused() {
        for list in
            ["", "91", "-1", "nan", "inf", "a", "0:90", "0:90:0", "0:90:-1", "90:0:10", "0:90:1e-9", "1,,2"]
        {
            let Err(Stop::BadInput(line)) = angles_deg("--angles-deg", list, 1000) else { panic!("{list}") };
            assert!(line.starts_with("--angles-deg: "), "{line}");
        }
        assert!(angles_deg("--angles-deg", "0:90:1", 91).is_ok());
        assert!(angles_deg("--angles-deg", "0:90:1", 90).is_err());
    }
}
