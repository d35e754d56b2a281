"""A Modbus TCP server of pyModbusTCP, an implementation foreign to ours.

Input registers 0 to 9: 215, -5, a float32 87.5 low word first, a uint32 70000; no further ones.
"""

import sys
import threading

from pyModbusTCP.server import DataBank, ModbusServer

bank = DataBank(i_regs_size=10, d_inputs_size=8)
bank.set_input_registers(0, [215, 0x10000 - 5, 0x0000, 0x42AF, 1, 4464])
bank.set_discrete_inputs(0, [False, True])
bank.set_holding_registers(0, list(range(100)))
server = ModbusServer(host="127.0.0.1", port=int(sys.argv[1]), no_block=True, data_bank=bank)
server.start()
sys.stdout.write("listening\n")
sys.stdout.flush()
threading.Event().wait()
