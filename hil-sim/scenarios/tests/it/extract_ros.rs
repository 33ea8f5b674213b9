//! Depth from a bag of a driver's.

use std::path::Path;

use crate::extract_vendor::Case;
use crate::support::run_python;
use crate::synthetic::Synthetic;
use extract::layout::Format;
use extract::options::Options;
use extract::report::LossPart;
use test_support::python;

/// A bag of a driver's, written by `rosbags`, gives what the camera's own file gives. One of
/// another form is refused with the command that makes one of it that is read.
#[test]
fn depth_of_a_driver_s_bag_finds_its_pulses() {
    let (case, _) = Case::new(&Synthetic {
        seed: 13,
        seconds: 20,
        slew: true,
        ..Synthetic::default()
    });
    case.extract(None, "own", Options::default());
    let own = case.table("own/depth_frames.csv", &[0, 1, 3]);
    let stamps: String = own
        .iter()
        .map(|row| format!("{}\n", row[1].unwrap()))
        .collect();
    std::fs::write(case.path("stamps.txt"), stamps).unwrap();
    for form in ["mcap", "zstd", "sqlite3"] {
        let mut bag = case.path(form);
        run_python(
            "make_depth_bag.py",
            &[&case.path("stamps.txt"), &bag, Path::new(form)],
        );
        let out = format!("of_{form}");
        if form != "mcap" {
            let refused = format!("refused_{form}");
            let refused = case.try_extract(Format::Euroc, Some(&bag), &refused, Options::default());
            let refusal = match refused {
                Err(error) => error.to_string(),
                Ok(report) => {
                    let mut losses = report.losses.into_iter();
                    losses
                        .find(|loss| loss.part == LossPart::Depth)
                        .unwrap()
                        .what
                }
            };
            python::run_conversion(&refusal);
            bag.set_file_name(format!("{form}-mcap"));
        }

        // The same pulses for the same frames; only the start of the file may be undecided.
        let report = case.extract(Some(&bag), &out, Options::default());
        let of_bag = case.table(&format!("{out}/depth_frames.csv"), &[0, 1, 3]);
        assert_eq!(of_bag, own, "{:#?}", report.losses);
        let depth = report.depth.unwrap();
        assert_eq!(
            depth.images,
            own.iter().filter(|row| row[2].is_some()).count() as u64
        );

        // Each picture is the one of its frame.
        let folder = case.path(&format!("{out}/mav0/depth0/data"));
        let mut pictures: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|f| f.unwrap().path())
            .collect();
        pictures.sort();
        let frames: Vec<usize> = (0..own.len())
            .filter(|&frame| own[frame][2].is_some())
            .collect();
        assert_eq!(pictures.len(), frames.len());
        for (frame, picture) in frames.iter().zip(&pictures).step_by(37) {
            let pixels = image::open(picture).unwrap().into_luma16().into_raw();
            let expected: Vec<u16> = (0..24).map(|n| (1000 + 7 * frame + n) as u16).collect();
            assert_eq!(pixels, expected, "{}", picture.display());
        }
    }

    let topic = Options {
        depth_topic: Some(String::from("/camera/color/depth")),
        ..Options::default()
    };
    let losses = case.extract(Some(&case.path("mcap")), "none", topic).losses;
    assert!(
        losses
            .iter()
            .any(|loss| format!("{loss:?}").contains("--depth-topic")),
        "{losses:?}"
    );
}
