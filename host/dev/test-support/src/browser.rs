//! A report in a real browser: headless Chromium opens it at the width of a phone
//! and of a desk, prints it on A4, and leaves pictures in `target/tmp/report`.
//!
//! The page itself has no script. A copy gets one for the test, which measures and
//! tells the page around it.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::processes::is_installed;
use crate::target;

/// Width of a phone in CSS pixels.
const PHONE: u32 = 360;

/// Width of a desk's window.
const DESK: u32 = 1_000;

/// A4 in points of 1/72 inch.
const A4: (f64, f64) = (595.0, 842.0);

const PROBE: &str = r#"<script>
addEventListener('load', () => {
  const sizes = [...document.querySelectorAll('.wide svg text')].map(text => {
    const svg = text.ownerSVGElement, box = svg.viewBox.baseVal;
    return parseFloat(getComputedStyle(text).fontSize) * svg.getBoundingClientRect().width / (box.width || svg.width.baseVal.value);
  });
  parent.postMessage({
    width: innerWidth, scroll: document.documentElement.scrollWidth, height: document.documentElement.scrollHeight,
    verdict: document.querySelector('.verdict')?.innerText, figures: document.querySelectorAll('svg').length,
    drawn: [...document.querySelectorAll('svg')].filter(svg => svg.getBoundingClientRect().height > 50).length,
    smallest: Math.min(99, ...sizes), text: parseFloat(getComputedStyle(document.body).fontSize),
    scripts: document.querySelectorAll('script').length, outside: performance.getEntriesByType('resource').length,
  }, '*');
});
</script></body>"#;

/// Returns the browser; without one, a test leaves the pages out ([`is_installed`]).
fn browser() -> Option<&'static str> {
    let answers = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let other = ["chromium-browser", "google-chrome"]
        .into_iter()
        .find(answers);
    other.or_else(|| is_installed("chromium", "chromium").then_some("chromium"))
}

fn run(browser: &str, profile: &Path, arguments: &[String]) -> (String, String) {
    let output = Command::new(browser)
        .args([
            "--headless=new",
            // The sandbox needs rights that a container does not have; the page is our own.
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--enable-logging=stderr",
            "--virtual-time-budget=4000",
        ])
        .arg(format!("--user-data-dir={}", profile.display()))
        .args(arguments)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

/// Width and height, out of the head of a PNG file.
fn png_size(picture: &Path) -> (u32, u32) {
    let bytes = fs::read(picture).unwrap();
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n", "{}", picture.display());
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (number(16), number(20))
}

fn url(path: &Path) -> String {
    format!("file://{}", path.display())
}

/// Opens a report and fails if anything is wrong with it. The pictures are called
/// `name`. Every text of `expected` must be in it.
pub fn check(html: &Path, name: &str, expected: &[&str]) {
    let page = fs::read_to_string(html).unwrap();
    for text in expected {
        assert!(page.contains(text), "{text:?} is not in the report");
    }
    for foreign in ["http://", "https://", "<script"] {
        let foreign_markup = page
            .replace("http://www.w3.org/2000/svg", "")
            .replace("http://www.w3.org/1999/xlink", "");
        assert!(!foreign_markup.contains(foreign), "{foreign} in the report");
    }
    let Some(browser) = browser() else {
        return;
    };
    let pictures = target().join("tmp/report");
    fs::create_dir_all(&pictures).unwrap();
    let work = tempfile::tempdir().unwrap();
    let place = |name: &str| work.path().join(name);
    fs::write(place("page.html"), &page).unwrap();
    fs::write(place("probed.html"), page.replace("</body>", PROBE)).unwrap();
    let frame = |file: &str, width: u32, height: u32| {
        format!(
            "<iframe src=\"{file}\" style=\"border:0;width:{width}px;height:{height}px\"></iframe>"
        )
    };
    fs::write(
        place("around.html"),
        format!(
            "<!DOCTYPE html><body><pre></pre><script>addEventListener('message', e => \
             document.querySelector('pre').append(JSON.stringify(e.data) + '\\n'))</script>{}{}</body>",
            frame("probed.html", PHONE, 800),
            frame("probed.html", DESK, 800)
        ),
    )
    .unwrap();

    let (dom, said) = run(
        browser,
        &place("profile"),
        &["--dump-dom".to_owned(), url(&place("around.html"))],
    );
    let complaints: Vec<&str> = said
        .lines()
        .filter(|line| line.contains("CONSOLE"))
        .collect();
    assert!(complaints.is_empty(), "the console says: {complaints:?}");
    let found: Vec<Value> = dom
        .split_once("<pre>")
        .and_then(|(_, rest)| rest.split_once("</pre>"))
        .expect("no answer from the page")
        .0
        .lines()
        .map(|line| {
            serde_json::from_str(
                &line
                    .replace("&amp;", "&")
                    .replace("&lt;", "<")
                    .replace("&gt;", ">"),
            )
            .unwrap()
        })
        .collect();
    assert_eq!(found.len(), 2, "{dom}");
    let mut height = 800;
    for seen in &found {
        let number = |name: &str| {
            seen[name]
                .as_f64()
                .unwrap_or_else(|| panic!("{name}: {seen}"))
        };
        assert!(
            number("scroll") <= number("width"),
            "the page is wider than its window: {seen}"
        );
        assert!(number("text") >= 16.0, "{seen}");
        assert!(
            number("smallest") >= 8.0,
            "type in a drawing is too small: {seen}"
        );
        assert!(number("figures") >= 1.0, "{seen}");
        assert_eq!(
            number("figures"),
            number("drawn"),
            "a drawing is empty: {seen}"
        );
        assert_eq!(number("outside"), 0.0, "something was loaded: {seen}");
        assert_eq!(number("scripts"), 1.0, "only the test's own: {seen}");
        assert!(seen["verdict"].as_str().unwrap().len() > 30, "{seen}");
        if number("width") < f64::from(DESK) {
            height = number("height") as u32;
        }
    }

    // Pictures for people: as on a phone, and on a desk.
    fs::write(
        place("phone.html"),
        format!(
            "<!DOCTYPE html><body style=\"margin:0\">{}</body>",
            frame("page.html", PHONE, height)
        ),
    )
    .unwrap();
    for (file, width, tall, out) in [
        ("phone.html", PHONE.max(500), height.min(9_000), "phone"),
        ("page.html", DESK, 2_600, "desk"),
    ] {
        let picture = pictures.join(format!("{name}_{out}.png"));
        run(
            browser,
            &place("profile"),
            &[
                format!("--window-size={width},{tall}"),
                format!("--screenshot={}", picture.display()),
                url(&place(file)),
            ],
        );
        let size = png_size(&picture);
        assert_eq!(size, (width, tall), "{}", picture.display());
    }

    let pdf = pictures.join(format!("{name}.pdf"));
    run(
        browser,
        &place("profile"),
        &[
            "--no-pdf-header-footer".to_owned(),
            format!("--print-to-pdf={}", pdf.display()),
            url(&place("page.html")),
        ],
    );
    let bytes = fs::read(&pdf).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with("%PDF-"));
    let boxes: Vec<(f64, f64)> = text
        .match_indices("/MediaBox [")
        .map(|(at, head)| {
            let numbers: Vec<f64> = text[at + head.len()..]
                .split([' ', ']'])
                .map_while(|number| number.parse().ok())
                .take(4)
                .collect();
            (numbers[2], numbers[3])
        })
        .collect();
    assert!(!boxes.is_empty(), "no page in {}", pdf.display());
    for (width, height) in boxes {
        assert!(
            (width - A4.0).abs() < 2.0 && (height - A4.1).abs() < 2.0,
            "a page of {width} by {height} points"
        );
    }
}
