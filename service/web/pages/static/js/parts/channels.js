// Written by service/web/pages/channels.py from service/domain/channels.py. Do not edit.
const STANDARD = [
  ["speed_rpm", "Speed", "rpm"],
  ["load_n", "Load", "N"],
  ["ambient_c", "Ambient", "°C"],
  ["t_inner_ring_c", "Inner ring", "°C"],
  ["t_outer_ring_c", "Outer ring", "°C"],
  ["phase", "Phase", ""],
  ["speed_setpoint_rpm", "Speed set-point", "rpm"],
  ["load_setpoint_n", "Load set-point", "N"],
];

/** Speed, load and ambient: the operating point. */
export const OPERATION = ['speed_rpm', 'load_n', 'ambient_c'];
/** What else is measured of the machine: shown and watched only. */
export const OBSERVED = [];
/** The temperatures of the rings that models compute. */
export const RINGS = ['t_inner_ring_c', 't_outer_ring_c'];
export const LABELS = Object.fromEntries(STANDARD.map(([name, label]) => [name, label]));
export const UNITS = Object.fromEntries(STANDARD.map(([name, , unit]) => [name, unit]));
