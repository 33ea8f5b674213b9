//! Numbers as the app's language prints them.

/// `Double.toString`, but for the number of digits: as few as read back exactly.
#[must_use]
pub(super) fn double(value: f64) -> String {
    arrange(
        &format!("{value:e}"),
        value.abs() < 1e-3 || value.abs() >= 1e7,
    )
}

/// `Float.toString`, but for the number of digits: as few as read back exactly.
#[must_use]
pub(super) fn float(value: f32) -> String {
    arrange(
        &format!("{value:e}"),
        value.abs() < 1e-3 || value.abs() >= 1e7,
    )
}

/// Turns Rust's `d.ddde±x` into `d.dddE±x`, or into a plain decimal number.
fn arrange(text: &str, scientific: bool) -> String {
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text.to_owned();
    };
    let zero = mantissa.trim_start_matches('-') == "0";
    if scientific && !zero {
        let dot = if mantissa.contains('.') { "" } else { ".0" };
        return format!("{mantissa}{dot}E{exponent}");
    }
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let (sign, digits) = match mantissa.strip_prefix('-') {
        Some(rest) => ("-", rest),
        None => ("", mantissa),
    };
    let digits: String = digits.chars().filter(|&c| c != '.').collect();
    if exponent < 0 {
        let zeros = "0".repeat(exponent.unsigned_abs() as usize - 1);
        return format!("{sign}0.{zeros}{digits}");
    }
    let whole = exponent.unsigned_abs() as usize + 1;
    if digits.len() <= whole {
        let zeros = "0".repeat(whole - digits.len());
        return format!("{sign}{digits}{zeros}.0");
    }
    let (head, tail) = digits.split_at(whole);
    format!("{sign}{head}.{tail}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_look_like_java_s() {
        for (value, text) in [
            (33_330_652.542_372_88, "3.333065254237288E7"),
            (3e7, "3.0E7"),
            (0.0, "0.0"),
            (-0.0, "-0.0"),
            (1.0, "1.0"),
            (123.456, "123.456"),
            (9_999_999.0, "9999999.0"),
            (0.001, "0.001"),
            (0.000_999, "9.99E-4"),
            (-0.015, "-0.015"),
        ] {
            assert_eq!(double(value), text);
            assert_eq!(text.parse::<f64>().unwrap(), value);
        }
        assert_eq!(float(-0.001_221_730_5), "-0.0012217305");
        assert_eq!(float(1e-4), "1.0E-4");
        assert_eq!(float(9.806_65), "9.80665");
    }
}
