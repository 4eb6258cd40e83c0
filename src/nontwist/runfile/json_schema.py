"""The JSON Schema of run files, made from the tables themselves; committed as docs/runfile.schema.json."""

from __future__ import annotations

from typing import Any

from .document import RunFile

Schema = dict[str, Any]


def json_schema() -> Schema:
    """Return the schema (draft 2020-12). TOML has no null, so neither has the schema: such keys are left out."""
    schema: Schema = _without_null(RunFile.model_json_schema())
    own = {"title": "nontwist run file", "description": "A run as a file describes it."}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, **own}


def _without_null(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_without_null(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(part) for key, part in schema.items() if part is not None}
    if {"type": "null"} in (forms := kept.get("anyOf", [])):
        forms = [form for form in forms if form != {"type": "null"}]
        rest = {key: part for key, part in kept.items() if key != "anyOf"}
        return {**forms[0], **rest} if len(forms) == 1 else {"anyOf": forms, **rest}
    return kept
