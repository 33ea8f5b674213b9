//! Figures of the book and the README, drawn from simulated runs.

use std::path::Path;

use anyhow::Result;

use crate::{firmware, process, tools};

/// Draws the figures into `docs/figures`.
pub(crate) fn make() -> Result<()> {
    tools::ensure_program("ffmpeg", "ffmpeg")?;
    tools::ensure_program("tmux", "tmux")?;
    tools::ensure_program("chromium", "chromium")?;
    let elf = firmware::build_rig()?;
    let python = tools::ensure_python()?;
    let draw = |script: &str, from: &Path, figure: &str| {
        let figure = Path::new("docs/figures").join(figure);
        let mut command = process::command(&python);
        command.arg(Path::new("xtask/figures").join(script));
        process::run(command.arg(from).arg(&figure))?;
        println!("{}", figure.display());
        anyhow::Ok(())
    };

    // The trigger as it moves onto the phone's frames in the demo's second session, and the top
    // of its data set's report.
    let demo = process::fresh_folder("figures-demo")?;
    process::hil_sim(&["demo".as_ref(), "--out".as_ref(), demo.as_os_str()], &elf)?;
    let dataset = demo.join("recording-euroc");
    draw("alignment.py", &dataset, "alignment.svg")?;
    let shot = demo.join("report.png");
    let mut browser = process::command("chromium");
    browser
        .args("--headless=new --no-sandbox --disable-gpu --hide-scrollbars".split(' '))
        .args("--log-level=3 --window-size=900,1905 --virtual-time-budget=4000".split(' '))
        .arg(format!("--user-data-dir={}/browser", demo.display()))
        .arg(format!("--screenshot={}", shot.display()))
        .arg(format!("file://{}/report.html", dataset.display()));
    process::run(&mut browser)?;
    draw("shrink.py", &shot, "report.png")?;

    // The live view of a recording, as its test leaves it.
    let test = "test --release --workspace --test it -- live_view::a_recording_is_led";
    process::cargo_with_elf(&test.split(' ').collect::<Vec<_>>(), &elf)?;
    let screen = process::target_dir().join("tmp/live_view/record_80x24.ansi");
    draw("terminal.py", &screen, "live-view.svg")
}
