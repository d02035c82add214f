//! Inner loops compiled for the instruction sets that matter. The arithmetic is the same, fused operations included, so the
//! bits are too.

/// An instruction set that this processor has been found to have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level(pub(super) Set);

/// Not for making a [`Level`] of: that is what [`Level::all`] is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Set {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Baseline,
}

impl Level {
    /// The widest.
    pub(super) fn detected() -> Self {
        Self::all()[0]
    }

    /// All that there are, the widest first.
    pub(super) fn all() -> Vec<Self> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            let common = is_x86_feature_detected!("fma") && is_x86_feature_detected!("bmi2");
            let wide = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl");
            if common && wide {
                sets.push(Self(Set::Avx512));
            }
            if common && is_x86_feature_detected!("avx2") {
                sets.push(Self(Set::Avx2));
            }
        }
        sets.push(Self(Set::Baseline));
        sets
    }
}

/// `at_each_level! { fn name(arguments) -> Result = body[8, 4, 2] }` is a function `name(level, arguments)` that runs `body::<W>`, which must be
/// `#[inline(always)]`, compiled for the level; `W` of AVX-512, AVX2 and the baseline stand in brackets behind it.
macro_rules! at_each_level {
    ($(#[$attribute:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),*) -> $result:ty = $body:ident[$wide:literal, $middle:literal, $narrow:literal]) => {
        $(#[$attribute])*
        #[allow(unsafe_code)] // without vector instructions it is slower by the factor that `rate_of_each_level` measures
        $visibility fn $name(level: $crate::dense::levels::Level, $($argument: $type),*) -> $result {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512dq,avx512vl,fma,bmi2")]
            fn avx512($($argument: $type),*) -> $result {
                $body::<$wide>($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,bmi2")]
            fn avx2($($argument: $type),*) -> $result {
                $body::<$middle>($($argument),*)
            }
            match level.0 {
                // SAFETY: a `Level` is only made where the features that the function is compiled for were found.
                #[cfg(target_arch = "x86_64")]
                $crate::dense::levels::Set::Avx512 => unsafe { avx512($($argument),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::dense::levels::Set::Avx2 => unsafe { avx2($($argument),*) },
                $crate::dense::levels::Set::Baseline => $body::<$narrow>($($argument),*),
            }
        }
    };
}
pub(super) use at_each_level;
