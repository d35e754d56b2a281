// Written by service/web/pages/channels.py from service/domain/channels.py. Do not edit.
const STANDARD = [
  ["speed_rpm", "Speed", "rpm", "operation"],
  ["load_n", "Load", "N", "operation"],
  ["ambient_c", "Ambient", "°C", "operation"],
  ["t_inner_ring_c", "Inner ring", "°C", "ring"],
  ["t_outer_ring_c", "Outer ring", "°C", "ring"],
  ["phase", "Phase", "", "controller"],
  ["speed_setpoint_rpm", "Speed set-point", "rpm", "controller"],
  ["load_setpoint_n", "Load set-point", "N", "controller"],
];

const names = (wanted) => STANDARD.filter(([, , , part]) => part === wanted).map(([name]) => name);

/** Speed, load and ambient: the operating point. */
export const OPERATION = names('operation');
/** The temperatures of the rings. */
export const RINGS = names('ring');
export const LABELS = Object.fromEntries(STANDARD.map(([name, label]) => [name, label]));
export const UNITS = Object.fromEntries(STANDARD.map(([name, , unit]) => [name, unit]));
