//! Tables as Arrow IPC files: written whole, read through a memory map without copying.

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int64Type, UInt16Type, UInt32Type,
};
use arrow_array::{
    Array, ArrayRef, FixedSizeBinaryArray, FixedSizeListArray, Float32Array, PrimitiveArray,
    RecordBatch,
};
use arrow_buffer::{Buffer, ScalarBuffer};
use arrow_ipc::convert::fb_to_schema;
use arrow_ipc::reader::{FileDecoder, read_footer_length};
use arrow_ipc::root_as_footer;
use arrow_ipc::writer::FileWriter;
use arrow_schema::{ArrowError, DataType, Field, Schema};

use super::mapped_file::map_file;
use crate::Error;

/// A column without missing values.
#[derive(Clone, Debug)]
pub(crate) enum Column {
    F64(ScalarBuffer<f64>),
    F32(ScalarBuffer<f32>),
    I64(ScalarBuffer<i64>),
    U32(ScalarBuffer<u32>),
    U16(ScalarBuffer<u16>),
    /// Rows of `width` bytes.
    Bytes {
        width: usize,
        values: Buffer,
    },
    /// Rows of `width` numbers.
    F32List {
        width: usize,
        values: ScalarBuffer<f32>,
    },
}

fn list_item() -> Arc<Field> {
    Arc::new(Field::new("item", DataType::Float32, false))
}

fn primitive<T: ArrowPrimitiveType>(values: &ScalarBuffer<T::Native>) -> ArrayRef {
    Arc::new(PrimitiveArray::<T>::new(values.clone(), None))
}

impl Column {
    fn to_array(&self) -> Result<ArrayRef, ArrowError> {
        Ok(match self {
            Self::F64(v) => primitive::<Float64Type>(v),
            Self::F32(v) => primitive::<Float32Type>(v),
            Self::I64(v) => primitive::<Int64Type>(v),
            Self::U32(v) => primitive::<UInt32Type>(v),
            Self::U16(v) => primitive::<UInt16Type>(v),
            Self::Bytes { width, values } => Arc::new(FixedSizeBinaryArray::try_new(
                *width as i32,
                values.clone(),
                None,
            )?),
            Self::F32List { width, values } => {
                let items = Arc::new(Float32Array::new(values.clone(), None));
                Arc::new(FixedSizeListArray::try_new(
                    list_item(),
                    *width as i32,
                    items,
                    None,
                )?)
            }
        })
    }

    fn from_array(array: &ArrayRef) -> Option<Self> {
        fn values<T: ArrowPrimitiveType>(array: &ArrayRef) -> Option<ScalarBuffer<T::Native>> {
            let array = array.as_any().downcast_ref::<PrimitiveArray<T>>()?;
            Some(array.values().clone())
        }
        if array.null_count() > 0 {
            return None;
        }
        match array.data_type() {
            DataType::Float64 => values::<Float64Type>(array).map(Self::F64),
            DataType::Float32 => values::<Float32Type>(array).map(Self::F32),
            DataType::Int64 => values::<Int64Type>(array).map(Self::I64),
            DataType::UInt32 => values::<UInt32Type>(array).map(Self::U32),
            DataType::UInt16 => values::<UInt16Type>(array).map(Self::U16),
            DataType::FixedSizeBinary(width) => {
                let array = array.as_any().downcast_ref::<FixedSizeBinaryArray>()?;
                let width = usize::try_from(*width).ok()?;
                let values = array.values().slice_with_length(0, width * array.len());
                Some(Self::Bytes { width, values })
            }
            DataType::FixedSizeList(_, width) => {
                let array = array.as_any().downcast_ref::<FixedSizeListArray>()?;
                let width = usize::try_from(*width).ok()?;
                let values = values::<Float32Type>(array.values())?;
                Some(Self::F32List { width, values })
            }
            _ => None,
        }
    }
}

/// A named column.
pub(crate) type NamedColumn = (&'static str, Column);

/// Writes a table as one record batch, to another name first, so that a file by this name is always whole.
pub(crate) fn write_table(path: &Path, columns: &[NamedColumn]) -> Result<(), Error> {
    let refuse = |e: ArrowError| Error::io(path)(std::io::Error::other(e));
    let mut fields = Vec::new();
    let mut arrays = Vec::new();
    for (name, column) in columns {
        let array = column.to_array().map_err(refuse)?;
        fields.push(Field::new(*name, array.data_type().clone(), false));
        arrays.push(array);
    }
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(refuse)?;
    let partial = path.with_extension("partial");
    let file = File::create(&partial).map_err(Error::io(&partial))?;
    let mut writer = FileWriter::try_new_buffered(file, &schema).map_err(refuse)?;
    writer.write(&batch).map_err(refuse)?;
    writer.finish().map_err(refuse)?;
    let buffered = writer.into_inner().map_err(refuse)?;
    let file = buffered
        .into_inner()
        .map_err(|e| Error::io(&partial)(e.into_error()))?;
    file.sync_all().map_err(Error::io(&partial))?;
    fs::rename(&partial, path).map_err(Error::io(path))
}

/// The bytes of a table's file, mapped into memory.
pub(crate) fn map_table(path: &Path) -> Result<Buffer, Error> {
    Ok(Buffer::from(map_file(path)?))
}

/// Reads the columns of a table from its file's bytes; `wanted` names them in order.
pub(crate) fn read_table(
    path: &Path,
    bytes: &Buffer,
    wanted: &[&'static str],
) -> Result<Vec<Column>, Error> {
    let refuse = |reason: String| Error::MapFile {
        path: path.to_owned(),
        reason,
    };
    let batch = decode(bytes).map_err(|e| refuse(e.to_string()))?;
    let column = |name: &&'static str| {
        let array = batch
            .column_by_name(name)
            .ok_or(refuse(format!("no column {name}")))?;
        Column::from_array(array).ok_or(refuse(format!("column {name} has another type")))
    };
    wanted.iter().map(column).collect()
}

fn decode(bytes: &Buffer) -> Result<RecordBatch, ArrowError> {
    let bad = |what: &str| ArrowError::ParseError(what.to_owned());
    let length = bytes.len();
    let tail = length
        .checked_sub(10)
        .ok_or(bad("too short for an Arrow file"))?;
    let trailer: [u8; 10] = bytes[tail..].try_into().map_err(|_| bad("no trailer"))?;
    let footer_length = read_footer_length(trailer)?;
    let start = tail
        .checked_sub(footer_length)
        .ok_or(bad("the footer is cut off"))?;
    let footer = root_as_footer(&bytes[start..tail]).map_err(|e| bad(&e.to_string()))?;
    let schema = fb_to_schema(footer.schema().ok_or(bad("no schema"))?);
    let decoder = FileDecoder::new(Arc::new(schema), footer.version());
    let blocks = footer.recordBatches().ok_or(bad("no record batch"))?;
    let block = blocks.iter().next().ok_or(bad("no record batch"))?;
    let from = usize::try_from(block.offset()).map_err(|_| bad("negative offset"))?;
    let metadata = usize::try_from(block.metaDataLength()).map_err(|_| bad("negative length"))?;
    let body = usize::try_from(block.bodyLength()).map_err(|_| bad("negative length"))?;
    let size = metadata.checked_add(body).ok_or(bad("too long"))?;
    if from.checked_add(size).is_none_or(|end| end > start) {
        return Err(bad("the record batch is cut off"));
    }
    let data = bytes.slice_with_length(from, size);
    decoder
        .read_record_batch(block, &data)?
        .ok_or(bad("no record batch"))
}
