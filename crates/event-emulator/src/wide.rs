//! Loops compiled for wider vectors where the core has them.

/// Calls a function that is always inlined, compiled for AVX-512 or AVX2 where the core has it. No product is fused with
/// a sum, so the result is the same to the bit.
macro_rules! wide {
    ($function:path, $($argument:ident: $type:ty),* $(; $result:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2")]
        fn by_avx2($($argument: $type),*) $(-> $result)? {
            $function($($argument),*)
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq")]
        fn by_avx512($($argument: $type),*) $(-> $result)? {
            $function($($argument),*)
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
        {
            // SAFETY: The core has these parts of AVX-512, which are all that the function needs.
            #[expect(unsafe_code, reason = "a call of a function for AVX-512")]
            return unsafe { by_avx512($($argument),*) };
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: The core has AVX2, which is all that the function needs.
            #[expect(unsafe_code, reason = "a call of a function for AVX2")]
            return unsafe { by_avx2($($argument),*) };
        }
        $function($($argument),*)
    }};
}
pub(crate) use wide;
