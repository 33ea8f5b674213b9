//! Download of a video from the connection to the disk.
//!
//! The bytes are streamed into a temporary file beside the target, which is synced and renamed
//! only after every announced byte has arrived. A failed download leaves no file, and an existing
//! file is overwritten only on request.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::connection::{CRAWL_FLOOR, Connection};
use super::error::PhoneError;
use super::file_name::safe_file_name;
use super::requests::VideoHeader;

/// Wait for further bytes after the announced end of a video.
const GRACE: Duration = Duration::from_millis(100);

/// A video that was downloaded completely.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SavedVideo {
    /// The file on this computer.
    pub path: PathBuf,
    /// Size of the file in bytes.
    pub size: u64,
    /// Name on the phone. It comes from the network, so it is for display only.
    pub phone_name: String,
}

/// Returns an error if `path` exists and is not to be overwritten.
pub(super) fn check_free(path: &Path, overwrite: bool) -> Result<(), PhoneError> {
    if !overwrite && path.symlink_metadata().is_ok() {
        return Err(PhoneError::TargetExists {
            path: path.to_owned(),
        });
    }
    Ok(())
}

/// Receives the video that `header` announced: into the folder `out`, under a name derived from
/// the phone's, or into the file `out`.
pub(super) fn receive(
    connection: &mut Connection,
    header: VideoHeader,
    out: &Path,
    overwrite: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<SavedVideo, PhoneError> {
    const REQUEST: &str = "get_video";
    let path = if out.is_dir() {
        out.join(safe_file_name(&header.file_name))
    } else {
        out.to_owned()
    };
    check_free(&path, overwrite)?;
    // At least CRAWL_FLOOR bytes must arrive within each window.
    let window = connection.margin.saturating_mul(2);
    let folder = system::folder_of(&path);
    let mut file = system::new_file_in(folder).map_err(|source| PhoneError::File {
        action: "create a file in",
        path: folder.to_owned(),
        source,
    })?;

    let mut received = 0u64;
    let mut window_start = Instant::now();
    let mut window_bytes = 0u64;
    progress(0, header.size);
    while received < header.size {
        let bytes = connection.bytes(REQUEST)?;
        if bytes.is_empty() {
            return Err(PhoneError::VideoTooShort {
                received,
                size: header.size,
            });
        }
        let left = usize::try_from(header.size - received).unwrap_or(usize::MAX);
        let bytes = bytes.get(..left).unwrap_or(bytes);
        file.write_all(bytes)
            .map_err(|source| PhoneError::writing(&path, source))?;
        let taken = bytes.len();
        connection.consume(taken);
        received += taken as u64;
        window_bytes += taken as u64;
        progress(received, header.size);
        if window_start.elapsed() >= window {
            if window_bytes < CRAWL_FLOOR && received < header.size {
                return Err(PhoneError::TooSlow {
                    received,
                    size: header.size,
                    floor: CRAWL_FLOOR,
                    window,
                });
            }
            window_start = Instant::now();
            window_bytes = 0;
        }
    }
    if connection.more_comes(GRACE) {
        return Err(PhoneError::VideoTooLong { size: header.size });
    }
    system::put_in_place(file, &path, overwrite)
        .map_err(|source| PhoneError::writing(&path, source))?;
    Ok(SavedVideo {
        path,
        size: header.size,
        phone_name: header.file_name,
    })
}
