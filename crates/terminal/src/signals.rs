//! What the system tells a process from outside.

use crate::Stop;
use signal_hook::consts as signals;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

/// A flag that Ctrl-C, SIGTERM and a closed terminal set, from the first call on, in place of ending the process.
///
/// # Errors
/// The system lets no handler be set.
pub fn interruption() -> Result<&'static AtomicBool, Stop> {
    static INTERRUPTED: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    if let Some(flag) = INTERRUPTED.get() {
        return Ok(flag);
    }
    let flag = Arc::<AtomicBool>::default();
    for signal in [
        signals::SIGINT,
        signals::SIGTERM,
        #[cfg(unix)]
        signals::SIGHUP,
    ] {
        signal_hook::flag::register(signal, Arc::clone(&flag)).map_err(Stop::failure)?;
    }
    Ok(INTERRUPTED.get_or_init(|| flag))
}

/// Makes a write beyond `ulimit -f` fail with EFBIG. Unhandled, SIGXFSZ would end the process in the middle of the file.
pub(crate) fn survive_file_size_limits() {
    #[cfg(unix)]
    {
        // Where no handler can be set, the limit does what it does without one.
        let _ = signal_hook::flag::register(signals::SIGXFSZ, Arc::default());
    }
}
