"""Tables of all keys of scene and sweep files, from the schemas beside the examples."""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "reference" / "generated"


def _words(rule):
    """What a value may be, in a few words."""
    if "$ref" in rule:
        name = rule["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    for key in ("anyOf", "oneOf"):
        if key in rule:
            kinds = [_words(one) for one in rule[key] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    if "const" in rule:
        return f"`{rule['const']}`"
    if "enum" in rule:
        return ", ".join(f"`{one}`" for one in rule["enum"])
    if "patternProperties" in rule:
        return "table of " + _words(next(iter(rule["patternProperties"].values())))
    if rule.get("type") == "array":
        count = rule.get("minItems") if rule.get("minItems") == rule.get("maxItems") else None
        items = rule.get("items") or (rule.get("prefixItems") or [{}])[0]
        return f"list of {count or ''} {_words(items)}".replace("  ", " ") if items else "list"
    if isinstance(rule.get("additionalProperties"), dict):
        return "table of " + _words(rule["additionalProperties"])
    bound = f" > {rule['exclusiveMinimum']:g}" if "exclusiveMinimum" in rule else ""
    kind = rule.get("type", "any")
    return {"object": "table", "string": "text"}.get(kind, kind) + bound


def _table(rule):
    lines = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for name, value in rule.get("properties", {}).items():
        default = value.get("default")
        default = "" if default is None else f"`{json.dumps(default)}`"
        default = "required" if name in rule.get("required", ()) else default
        cells = (f"`{name}`", _words(value), default, value.get("description", ""))
        plain = [cell.replace("|", "\\|").replace("\n", " ") for cell in cells]
        lines.append(f"| {' | '.join(plain)} |")
    return lines


def _page(schema):
    lines = _table(schema)
    for name, rule in sorted(schema["$defs"].items()):
        lines += ["", f"### {name}", "", rule.get("description", "").split("\n\n")[0], ""]
        lines += _table(rule) if rule.get("properties") else [_words(rule)]
    return "\n".join(lines) + "\n"


def setup(app):
    """Write the pages' parts before any page is read."""
    FOLDER.mkdir(exist_ok=True)
    for name in ("scene", "sweep"):
        schema = json.loads((ROOT / "examples" / f"{name}s" / f"{name}.schema.json").read_text())
        (FOLDER / f"{name}.txt").write_text(_page(schema))
    return {"parallel_read_safe": True}
