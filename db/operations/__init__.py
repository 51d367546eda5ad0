"""Operations: catalogue, alarms, notes, torque releases, links, keys, audit."""
