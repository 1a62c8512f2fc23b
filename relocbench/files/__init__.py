"""Files that appear whole or not at all, and text that says where it is wrong.

Every text that others wrote is read here: UTF-8 text and its lines, tables, numbers, times, YAML, JSON and names. What
cannot be read is a :class:`~relocbench.errors.RelocbenchError` of one line with file and line number; sizes, depths
and lengths are limited, so that no file costs more than its reading.
"""

from relocbench.files.json_text import json_text, parse_json, read_journal, strict_json
from relocbench.files.names import (
    MAX_FOLDER_BYTES,
    check_distinct,
    check_joined_name,
    check_label,
    check_name,
    fitting_name,
    natural,
    plain_name,
)
from relocbench.files.nearby import did_you_mean
from relocbench.files.numbers import (
    parse_count,
    parse_floats,
    parse_seconds,
    parse_timestamp,
    quick_counts,
    quick_floats,
    seconds_to_ns,
    whole_number,
)
from relocbench.files.plain import plain_file, read_bytes
from relocbench.files.tables import (
    CHUNK_ROWS,
    header_fault,
    read_csv,
    read_table,
    read_table_chunks,
    values_by_time,
    write_table,
)
from relocbench.files.text import fields_of, lines_of, read_rows, read_text
from relocbench.files.writing import (
    atomic_write,
    link_file,
    locked_folder,
    locked_output,
    remove_parts,
    sha256_file,
    write_bytes,
    write_text,
)
from relocbench.files.yaml_files import (
    dump_yaml,
    first_fault,
    load_yaml,
    load_yaml_value,
    load_yaml_values,
    yaml_line,
)
from relocbench.files.yaml_text import YamlFault, YamlPlaces, parse_yaml, parse_yaml_setting

__all__ = [
    "CHUNK_ROWS",
    "MAX_FOLDER_BYTES",
    "YamlFault",
    "YamlPlaces",
    "atomic_write",
    "check_distinct",
    "check_joined_name",
    "check_label",
    "check_name",
    "did_you_mean",
    "dump_yaml",
    "fields_of",
    "first_fault",
    "fitting_name",
    "header_fault",
    "json_text",
    "lines_of",
    "link_file",
    "load_yaml",
    "load_yaml_value",
    "load_yaml_values",
    "locked_folder",
    "locked_output",
    "natural",
    "parse_count",
    "parse_floats",
    "parse_json",
    "parse_seconds",
    "parse_timestamp",
    "parse_yaml",
    "parse_yaml_setting",
    "plain_file",
    "plain_name",
    "quick_counts",
    "quick_floats",
    "read_bytes",
    "read_csv",
    "read_journal",
    "read_rows",
    "read_table",
    "read_table_chunks",
    "read_text",
    "remove_parts",
    "seconds_to_ns",
    "sha256_file",
    "strict_json",
    "values_by_time",
    "whole_number",
    "write_bytes",
    "write_table",
    "write_text",
    "yaml_line",
]
