//! Texture files for other programs: DDS and KTX2 for volumes, OpenEXR for the pages of an atlas.
//!
//! Formats: "Programming Guide for DDS" (Microsoft), KTX File Format Specification 2.0 (Khronos), OpenEXR. The crates
//! `ddsfile`, `ktx2` and `exr` encode and decode the headers; this file chooses their values for a field. The sizes in
//! a file are compared with each other before its texels are read, and nothing is larger in memory than it is in the
//! file. The reader of the crate `ktx2` panics on damaged data-format descriptors, so a KTX2 file is read here, by its
//! header.

use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error, FormatError};
use ddsfile::{AlphaMode, Caps2, D3D10ResourceDimension, Dds, DxgiFormat, NewDxgiParams, PixelFormatFlags};
use exr::prelude as openexr;
use exr::prelude::{ReadChannels, ReadLayers, WritableImage};
use half::f16;
use std::io::Cursor;

/// A volume in a texture file: one channel, no mipmaps, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Width, height and depth.
    pub size: [u32; 3],
    pub encoding: Encoding,
    pub texels: Vec<u8>,
}

/// Texels of a DDS file are counted in 32 bits.
const DDS_LIMIT: usize = u32::MAX as usize;
/// Key of the metadata of fieldbake in a KTX2 file.
const FACTS_KEY: &str = "fieldbake";
/// The standard key for the directions in which texels are stored, and its value: x to the right, y up, and z out of
/// the picture towards the viewer, which makes the axes right-handed. Without the key readers take y as down.
const ORIENTATION: (&[u8], &[u8]) = (b"KTXorientation", b"ruo\0");

impl Texture {
    /// Texels that do not match the size are an error of the caller.
    fn check(&self) -> Result<(), Error> {
        Self::checked(self.size, self.encoding, self.texels.len())
    }

    /// A DDS file with the extended header: a 3D texture of R32_FLOAT, R16_FLOAT, R16_SNORM or R8_SNORM.
    pub fn to_dds(&self) -> Result<Vec<u8>, Error> {
        self.check()?;
        if self.texels.len() > DDS_LIMIT {
            let problem = format!("a DDS file holds at most {DDS_LIMIT} bytes, got {}", self.texels.len());
            return Err(ArgumentError::new("path", problem).into());
        }
        let [width, height, depth] = self.size;
        let format = match self.encoding {
            Encoding::Float32 => DxgiFormat::R32_Float,
            Encoding::Float16 => DxgiFormat::R16_Float,
            Encoding::Snorm16 => DxgiFormat::R16_SNorm,
            Encoding::Snorm8 => DxgiFormat::R8_SNorm,
        };
        let params = NewDxgiParams {
            height,
            width,
            depth: Some(depth),
            format,
            mipmap_levels: None,
            array_layers: None,
            caps2: Some(Caps2::VOLUME),
            is_cubemap: false,
            resource_dimension: D3D10ResourceDimension::Texture3D,
            alpha_mode: AlphaMode::Unknown,
        };
        let mut file = Dds::new_dxgi(params).map_err(|error| failed(&error.to_string()))?;
        // The extended header has the format. Readers take a file that also claims to be RGB for an RGB picture.
        file.header.spf.flags = PixelFormatFlags::FOURCC;
        file.header.spf.rgb_bit_count = None;
        file.data.copy_from_slice(&self.texels);
        let mut bytes = Vec::with_capacity(self.texels.len() + 256);
        file.write(&mut bytes).map_err(|error| failed(&error.to_string()))?;
        Ok(bytes)
    }

    /// Reads a file of [`Texture::to_dds`].
    pub fn from_dds(bytes: &[u8]) -> Result<Self, Error> {
        let file = Dds::read(bytes).map_err(|error| failed(&error.to_string()))?;
        let encoding = match file.get_dxgi_format() {
            Some(DxgiFormat::R32_Float) => Encoding::Float32,
            Some(DxgiFormat::R16_Float) => Encoding::Float16,
            Some(DxgiFormat::R16_SNorm) => Encoding::Snorm16,
            Some(DxgiFormat::R8_SNorm) => Encoding::Snorm8,
            other => return Err(failed(&format!("a field has one channel, the file has {other:?}"))),
        };
        let size = [file.get_width(), file.get_height(), file.get_depth()];
        Self::checked(size, encoding, file.data.len())?;
        Ok(Self { size, encoding, texels: file.data })
    }

    /// A KTX2 file without compression, with the metadata of fieldbake among its key/value data.
    pub fn to_ktx2(&self, facts: &str) -> Result<Vec<u8>, Error> {
        self.check()?;
        let format = match self.encoding {
            Encoding::Float32 => ktx2::Format::R32_SFLOAT,
            Encoding::Float16 => ktx2::Format::R16_SFLOAT,
            Encoding::Snorm16 => ktx2::Format::R16_SNORM,
            Encoding::Snorm8 => ktx2::Format::R8_SNORM,
        };
        let (descriptor, type_size) =
            ktx2::dfd::Basic::from_format(format).map_err(|error| failed(&format!("{error:?}")))?;
        let descriptor = ktx2::dfd::Block::Basic(descriptor).to_vec();
        // The section begins with its own length.
        let mut formats = ((descriptor.len() + 4) as u32).to_le_bytes().to_vec();
        formats.extend(descriptor);
        let writer = concat!("fieldbake ", env!("CARGO_PKG_VERSION"), "\0");
        let mut pairs = Vec::new();
        // Keys must be in the order of their bytes.
        let facts = (FACTS_KEY.as_bytes(), facts.as_bytes());
        for (key, value) in [ORIENTATION, (b"KTXwriter", writer.as_bytes()), facts] {
            pairs.extend(((key.len() + 1 + value.len()) as u32).to_le_bytes());
            pairs.extend([key, b"\0", value].concat());
            pairs.resize(pairs.len().next_multiple_of(4), 0);
        }
        let formats_at = ktx2::Header::LENGTH + ktx2::LevelIndex::LENGTH;
        let pairs_at = formats_at + formats.len();
        let texels_at = (pairs_at + pairs.len()).next_multiple_of(4);
        let [pixel_width, pixel_height, pixel_depth] = self.size;
        let header = ktx2::Header {
            format: Some(format),
            type_size,
            pixel_width,
            pixel_height,
            pixel_depth,
            layer_count: 0,
            face_count: 1,
            level_count: 1,
            supercompression_scheme: None,
            index: ktx2::Index {
                dfd_byte_offset: formats_at as u32,
                dfd_byte_length: formats.len() as u32,
                kvd_byte_offset: pairs_at as u32,
                kvd_byte_length: pairs.len() as u32,
                sgd_byte_offset: 0,
                sgd_byte_length: 0,
            },
        };
        let length = self.texels.len() as u64;
        let level =
            ktx2::LevelIndex { byte_offset: texels_at as u64, byte_length: length, uncompressed_byte_length: length };
        let mut bytes = Vec::with_capacity(texels_at + self.texels.len());
        bytes.extend(header.as_bytes());
        bytes.extend(level.as_bytes());
        bytes.extend(formats);
        bytes.extend(pairs);
        bytes.resize(texels_at, 0);
        bytes.extend(&self.texels);
        Ok(bytes)
    }

    /// Reads a file of [`Texture::to_ktx2`] and its metadata.
    pub fn from_ktx2(bytes: &[u8]) -> Result<(Self, String), Error> {
        let header = bytes.first_chunk().ok_or_else(|| failed("the file ends within its header"))?;
        let header = ktx2::Header::from_bytes(header).map_err(|error| failed(&format!("{error:?}")))?;
        let encoding = match header.format {
            Some(ktx2::Format::R32_SFLOAT) => Encoding::Float32,
            Some(ktx2::Format::R16_SFLOAT) => Encoding::Float16,
            Some(ktx2::Format::R16_SNORM) => Encoding::Snorm16,
            Some(ktx2::Format::R8_SNORM) => Encoding::Snorm8,
            other => return Err(failed(&format!("a field has one channel, the file has {other:?}"))),
        };
        let is_plain = header.supercompression_scheme.is_none() && header.level_count <= 1;
        if !is_plain || header.layer_count > 1 || header.face_count != 1 {
            return Err(failed("a field is one 3D texture without compression and mipmaps"));
        }
        let pairs = section(bytes, header.index.kvd_byte_offset.into(), header.index.kvd_byte_length.into())?;
        let facts = ktx2::KeyValueDataIterator::new(pairs).find(|(key, _)| *key == FACTS_KEY);
        let facts = facts.and_then(|(_, value)| String::from_utf8(value.to_vec()).ok());
        let level = bytes[ktx2::Header::LENGTH..].first_chunk().ok_or_else(|| failed("there are no texels"))?;
        let level = ktx2::LevelIndex::from_bytes(level);
        let texels = section(bytes, level.byte_offset, level.byte_length)?;
        let size = [header.pixel_width, header.pixel_height, header.pixel_depth];
        Self::checked(size, encoding, texels.len())?;
        Ok((Self { size, encoding, texels: texels.to_vec() }, facts.unwrap_or_default()))
    }

    /// Fails if the number of bytes does not match such a volume.
    fn checked(size: [u32; 3], encoding: Encoding, bytes: usize) -> Result<(), Error> {
        let expected = size.iter().try_fold(encoding.bytes(), |bytes, &n| bytes.checked_mul(n as usize));
        if expected != Some(bytes) || bytes == 0 {
            let [width, height, depth] = size;
            return Err(failed(&format!("{bytes} bytes are not {width} x {height} x {depth} texels")));
        }
        Ok(())
    }
}

/// An OpenEXR file with one channel, `Y`: FLOAT for f32, HALF for f16. ZIP compression, without loss.
pub fn write_exr(width: usize, height: usize, encoding: Encoding, texels: &[u8]) -> Result<Vec<u8>, Error> {
    let samples = match encoding {
        Encoding::Float16 => {
            let halves = bytemuck::cast_slice::<_, u16>(texels).iter().map(|&bits| f16::from_bits(bits)).collect();
            openexr::FlatSamples::F16(halves)
        }
        _ => openexr::FlatSamples::F32(bytemuck::cast_slice(texels).to_vec()),
    };
    let channels = openexr::AnyChannels::sort([openexr::AnyChannel::new("Y", samples)].into_iter().collect());
    let attributes = openexr::LayerAttributes::named("fieldbake atlas");
    let encoding = openexr::Encoding { compression: openexr::Compression::ZIP16, ..openexr::Encoding::FAST_LOSSLESS };
    let layer = openexr::Layer::new((width, height), attributes, encoding, channels);
    let mut file = Cursor::new(Vec::new());
    openexr::Image::from_layer(layer).write().to_buffered(&mut file).map_err(|error| failed(&error.to_string()))?;
    Ok(file.into_inner())
}

/// Reads the texels of a file of [`write_exr`]. The size is known from elsewhere, and compared before decompression.
pub fn read_exr(bytes: &[u8], width: usize, height: usize, encoding: Encoding) -> Result<Vec<u8>, Error> {
    let told = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), true);
    let told = told.map_err(|error| failed(&error.to_string()))?;
    let fits = |header: &exr::meta::header::Header| {
        header.layer_size == exr::math::Vec2(width, height) && header.channels.list.len() == 1 && !header.deep
    };
    if told.headers.len() != 1 || !told.headers.iter().all(fits) {
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

/// The bytes of a section of a file; an error if it extends beyond the file.
fn section(bytes: &[u8], offset: u64, length: u64) -> Result<&[u8], Error> {
    let end = offset.checked_add(length).filter(|&end| end <= bytes.len() as u64);
    let end = end.ok_or_else(|| failed(&format!("{length} bytes from byte {offset} on are not in the file")))?;
    Ok(&bytes[offset as usize..end as usize])
}

fn failed(reason: &str) -> Error {
    FormatError(reason.to_owned()).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn texture(encoding: Encoding) -> Texture {
        let size = [5, 3, 2];
        let texels = (0..30 * encoding.bytes()).map(|i| i as u8 % 60).collect();
        Texture { size, encoding, texels }
    }

    #[test]
    fn textures_come_back() {
        for encoding in Encoding::ALL {
            let texture = texture(encoding);
            assert_eq!(Texture::from_dds(&texture.to_dds().unwrap()).unwrap(), texture);
            let facts = "{\"é\": 1}";
            assert_eq!(Texture::from_ktx2(&texture.to_ktx2(facts).unwrap()).unwrap(), (texture, facts.to_owned()));
        }
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
        fn damaged_files_are_errors(which in 0..3, at in any::<prop::sample::Index>(), value in any::<u8>(), cut in any::<bool>()) {
            let texture = texture(Encoding::Float32);
            let mut file = match which {
                0 => texture.to_dds().unwrap(),
                1 => texture.to_ktx2("{}").unwrap(),
                _ => write_exr(6, 5, Encoding::Float32, &texture.texels).unwrap(),
            };
            let at = at.index(file.len());
            if cut { file.truncate(at) } else { file[at] = value }
            // These formats have no checksum of the texels, only of the sizes.
            match which {
                0 => drop(Texture::from_dds(&file).map(|found| found.check().unwrap())),
                1 => drop(Texture::from_ktx2(&file).map(|(found, _)| found.check().unwrap())),
                _ => drop(read_exr(&file, 6, 5, Encoding::Float32).map(|found| assert_eq!(found.len(), 120))),
            }
        }
    }
}
