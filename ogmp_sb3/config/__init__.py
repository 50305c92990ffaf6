"""What YAML files say: name, file, plain data, dataclass, checked task."""
