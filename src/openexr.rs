//! Reads OpenEXR files of one channel: the pages of an atlas and sheets of slices.
//!
//! The crate `exr` decodes; `python/fieldbake/files/exr.py` encodes. The size in a file is compared with the expected
//! one before its texels are decompressed.

use crate::encoding::Encoding;
use crate::error::{Error, FormatError};
use exr::prelude as openexr;
use exr::prelude::{ReadChannels, ReadLayers};
use std::io::Cursor;

/// Reads the texels of a file of one channel, FLOAT or HALF. The caller knows the size, which is compared before
/// decompression.
pub(crate) fn read_exr(bytes: &[u8], width: usize, height: usize, encoding: Encoding) -> Result<Vec<u8>, Error> {
    let found = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), true);
    let found = found.map_err(|error| failed(&error.to_string()))?;
    let fits = |header: &exr::meta::header::Header| {
        header.layer_size == exr::math::Vec2(width, height) && header.channels.list.len() == 1 && !header.deep
    };
    if found.headers.len() != 1 || !found.headers.iter().all(fits) {
        return Err(failed(&format!("the image is not one channel of {width} x {height} pixels")));
    }
    let image = openexr::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .pedantic()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| failed(&error.to_string()))?;
    let channel = image.layer_data.channel_data.list.first().ok_or_else(|| failed("there is no channel"))?;
    match (&channel.sample_data, encoding) {
        (openexr::FlatSamples::F16(samples), Encoding::Float16) => {
            Ok(samples.iter().flat_map(|half| half.to_bits().to_ne_bytes()).collect())
        }
        (openexr::FlatSamples::F32(samples), Encoding::Float32 | Encoding::Snorm16 | Encoding::Snorm8) => {
            Ok(bytemuck::cast_slice(samples).to_vec())
        }
        _ => Err(failed("the channel has another type")),
    }
}

fn failed(reason: &str) -> Error {
    FormatError(reason.to_owned()).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::WritableImage;
    use half::f16;
    use proptest::prelude::*;

    /// An OpenEXR file with one channel, `Y`: FLOAT for f32, HALF for f16. ZIP compression, without loss.
    fn write_exr(width: usize, height: usize, encoding: Encoding, texels: &[u8]) -> Result<Vec<u8>, Error> {
        let samples = match encoding {
            Encoding::Float16 => {
                let halves = bytemuck::cast_slice::<_, u16>(texels).iter().map(|&bits| f16::from_bits(bits)).collect();
                openexr::FlatSamples::F16(halves)
            }
            _ => openexr::FlatSamples::F32(bytemuck::cast_slice(texels).to_vec()),
        };
        let channels = openexr::AnyChannels::sort([openexr::AnyChannel::new("Y", samples)].into_iter().collect());
        let attributes = openexr::LayerAttributes::named("fieldbake atlas");
        let encoding =
            openexr::Encoding { compression: openexr::Compression::ZIP16, ..openexr::Encoding::FAST_LOSSLESS };
        let layer = openexr::Layer::new((width, height), attributes, encoding, channels);
        let mut file = Cursor::new(Vec::new());
        openexr::Image::from_layer(layer).write().to_buffered(&mut file).map_err(|error| failed(&error.to_string()))?;
        Ok(file.into_inner())
    }

    #[test]
    fn pages_come_back() {
        for encoding in [Encoding::Float32, Encoding::Float16] {
            let words: Vec<u32> = (0..20 * encoding.bytes() as u32 / 4).map(|i| 0x3c00_3c00 + i * 0x0101).collect();
            let texels: &[u8] = bytemuck::cast_slice(&words);
            let file = write_exr(5, 4, encoding, texels).unwrap();
            assert_eq!(read_exr(&file, 5, 4, encoding).unwrap(), texels);
            assert!(read_exr(&file, 4, 5, encoding).is_err());
        }
    }

    proptest! {
        #[test]
        fn damaged_files_are_errors(at in any::<prop::sample::Index>(), value in any::<u8>(), cut in any::<bool>()) {
            let mut file = write_exr(6, 5, Encoding::Float32, bytemuck::cast_slice(&[7u32; 30])).unwrap();
            let at = at.index(file.len());
            if cut { file.truncate(at) } else { file[at] = value }
            // The format has no checksum of the texels, only of the sizes.
            if let Ok(texels) = read_exr(&file, 6, 5, Encoding::Float32) {
                prop_assert_eq!(texels.len(), 120);
            }
        }
    }
}
