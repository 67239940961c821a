-- Copyright 2026 The mecarover_serial authors
-- SPDX-License-Identifier: GPL-2.0-or-later
--
-- Wireshark dissector of servo buses: Dynamixel Protocol 2.0 and 1.0, Feetech. For files that
-- dxl_dump -w FILE.pcapng writes, and what usbmon or USBPcap recorded of a serial adapter.
-- Wireshark 4.0 (Lua 5.2) or newer. It needs servobus_tables.lua in the same folder, which
-- `dxl_dump --wireshark DIR` writes: docs/dump.md.
--
-- Wireshark calls it once for each packet in order, then again in any order: what it learns
-- (models, which answer belongs to which instruction) it learns the first time.

local folder = debug.getinfo(1, 'S').source:sub(2):match('^(.*[/\\])') or ''
local is_read, tables = pcall(dofile, folder .. 'servobus_tables.lua')
if not is_read or type(tables) ~= 'table' then
    report_failure(('%sservobus_tables.lua: missing or damaged (%s); write it: dxl_dump --wireshark "%s"')
        :format(folder, tostring(tables), folder == '' and '.' or folder))
    return
end
local servobus = Proto('servobus', 'Servo bus (Dynamixel, Feetech)')

local PING, READ, WRITE, REG_WRITE, STATUS = 0x01, 0x02, 0x03, 0x04, 0x55
local SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
local BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
local BROADCAST, ALERT = 254, 0x80
local FEETECH_KEY = 0x10000            -- added to the number of a Feetech model in the tables
local MODEL_NUMBER = {['2'] = 0, ['1'] = 0, feetech = 3}           -- where a device has it
local OUTBOUND, INBOUND = 2, 1

servobus.prefs.family = Pref.enum('FF FF begins packets of', 1, 'Dynamixel Protocol 1.0 and '
    .. 'Feetech begin alike', {{1, 'Dynamixel 1.0', 1}, {2, 'Feetech', 2}}, false)
servobus.prefs.devices = Pref.string('Devices', '', 'Models by ID, e.g. 1-20:MX-106,30:XL-320. '
    .. 'Learned from answers to Ping where they are recorded')

local fields = {
    protocol = ProtoField.string('servobus.protocol', 'Protocol'),
    id = ProtoField.uint8('servobus.id', 'ID'),
    length = ProtoField.uint16('servobus.length', 'Length'),
    instruction = ProtoField.uint8('servobus.instruction', 'Instruction', base.HEX),
    name = ProtoField.string('servobus.instruction.name', 'Instruction'),
    error = ProtoField.uint8('servobus.error', 'Error', base.HEX),
    params = ProtoField.bytes('servobus.params', 'Parameters'),
    checksum = ProtoField.uint16('servobus.checksum', 'Checksum', base.HEX),
    noise = ProtoField.bytes('servobus.noise', 'No packet'),
    model_number = ProtoField.uint16('servobus.model_number', 'Model number'),
    model = ProtoField.string('servobus.model', 'Model'),
    firmware = ProtoField.uint8('servobus.firmware', 'Firmware'),
    device = ProtoField.uint8('servobus.device', 'Device'),
    address = ProtoField.uint16('servobus.address', 'Address'),
    size = ProtoField.uint16('servobus.size', 'Size'),
    data = ProtoField.bytes('servobus.data', 'Data'),
    register = ProtoField.string('servobus.register', 'Register'),
    value = ProtoField.double('servobus.value', 'Value'),
    request = ProtoField.framenum('servobus.request_in', 'Answers the instruction in',
        base.NONE, frametype.REQUEST),
    response = ProtoField.framenum('servobus.response_in', 'Answered in', base.NONE,
        frametype.RESPONSE),
    time = ProtoField.double('servobus.time', 'Time since the instruction (ms)'),
    missing = ProtoField.uint8('servobus.missing', 'No answer from'),
}
servobus.fields = fields
local experts = {
    damaged = ProtoExpert.new('servobus.damaged', 'Damaged', expert.group.CHECKSUM,
        expert.severity.ERROR),
    noise = ProtoExpert.new('servobus.no_packet', 'Bytes that are no packet',
        expert.group.MALFORMED, expert.severity.WARN),
    error = ProtoExpert.new('servobus.device_error', 'The device reports an error',
        expert.group.RESPONSE_CODE, expert.severity.WARN),
    missing = ProtoExpert.new('servobus.no_answer', 'No answer', expert.group.SEQUENCE,
        expert.severity.WARN),
}
servobus.experts = experts
local direction = Field.new('frame.packet_flags_direction')
local interface = Field.new('frame.interface_id')

local links, missing, packets, pending, models = {}, {}, {}, {}, {}
local streams, found_on_usb, is_ftdi = {}, {}, {}      -- USB: bytes that wait, packets by frame

function servobus.init()
    links, missing, packets, pending, models = {}, {}, {}, {}, {}
    streams, found_on_usb, is_ftdi = {}, {}, {}
end

-- --- bytes ----------------------------------------------------------------------------------

local function u16(bytes, at)                  -- `at` counts from 0, here and below
    return bytes:get_index(at) + 256 * bytes:get_index(at + 1)
end

local function crc16(bytes)                    -- polynomial 0x8005, as all of Protocol 2.0
    local crc = 0
    for at = 0, bytes:len() - 1 do
        crc = bit.bxor(crc, bit.lshift(bytes:get_index(at), 8))
        for _ = 1, 8 do
            local high = bit.band(crc, 0x8000)
            crc = bit.band(bit.lshift(crc, 1), 0xFFFF)
            if high ~= 0 then crc = bit.bxor(crc, 0x8005) end
        end
    end
    return crc
end

local function slice(bytes, from, size)
    return size > 0 and bytes:subset(from, size) or ByteArray.new()
end

local function unstuffed(bytes)                -- FF FF FD FD means FF FF FD
    local text = bytes:raw()
    local plain = text:gsub('\255\255\253\253', '\255\255\253')
    return #plain == #text and bytes or ByteArray.new(plain, true)
end

-- --- packets --------------------------------------------------------------------------------

--- The bytes of a packet of 2.0, and how many are missing in front: an adapter that turns the line
--- round late loses or damages the first one. Nothing for anything else.
local function whole_2(bytes)
    local text = bytes:raw()
    if text:sub(2, 4) == '\255\253\0' then
        return ByteArray.new('\255' .. text:sub(2), true), 0
    elseif text:sub(1, 3) == '\255\253\0' then
        return ByteArray.new('\255' .. text, true), 1
    end
end

--- {protocol, id, code, error, params, checksum, is_status, length}, or nothing and why.
local function parse_2(bytes, missing_bytes)
    local size = bytes:len()
    if size < 10 or u16(bytes, 5) + 7 ~= size then return nil, 'impossible Length, or cut off' end
    if crc16(slice(bytes, 0, size - 2)) ~= u16(bytes, size - 2) then return nil, 'wrong CRC' end
    local is_status = bytes:get_index(7) == STATUS and size > 10
    local from = is_status and 9 or 8
    return {protocol = '2', id = bytes:get_index(4), length = u16(bytes, 5), from = from,
            code = bytes:get_index(7), is_status = is_status, size = size - 2 - from,
            error = is_status and bytes:get_index(8) or nil, checksum = u16(bytes, size - 2),
            shift = missing_bytes,
            params = unstuffed(slice(bytes, from, size - 2 - from))}
end

local function parse_1(bytes, way, waiting)
    local size = bytes:len()
    if size < 6 or bytes:get_index(3) + 4 ~= size then
        return nil, 'impossible Length, or cut off'
    end
    local sum = 0
    for at = 2, size - 2 do sum = sum + bytes:get_index(at) end
    if 255 - sum % 256 ~= bytes:get_index(size - 1) then return nil, 'wrong checksum' end
    local id, code = bytes:get_index(2), bytes:get_index(4)
    local is_status = way == INBOUND
    if way ~= INBOUND and way ~= OUTBOUND then
        is_status = id ~= BROADCAST and waiting ~= nil and waiting.left[id] ~= nil
    end
    return {protocol = '1', shift = 0, id = id, length = bytes:get_index(3), from = 5, size = size - 6,
            code = is_status and STATUS or code, is_status = is_status,
            error = is_status and code or nil, checksum = bytes:get_index(size - 1),
            params = slice(bytes, 5, size - 6)}
end

-- --- instructions ---------------------------------------------------------------------------

local function listed(params, at, size, each)
    while at + size <= params:len() do
        each(at)
        at = at + size
    end
end

--- What is asked for: {id, address, size, data}, and whether each of them has to answer.
local function accesses_of(packet)
    local found, p, code = {}, packet.params, packet.code
    local function add(id, address, size, at)      -- at: where its data begin, if it writes
        found[#found + 1] = {id = id, address = address, size = size, at = at,
                             data = at and slice(p, at, size)}
    end
    local count = p:len()
    if packet.protocol ~= '2' then
        if code == READ and count == 2 then
            add(packet.id, p:get_index(0), p:get_index(1))
        elseif (code == WRITE or code == REG_WRITE) and count > 1 then
            add(packet.id, p:get_index(0), count - 1, 1)
        elseif code == SYNC_READ and count > 2 then
            listed(p, 2, 1, function(at) add(p:get_index(at), p:get_index(0), p:get_index(1)) end)
        elseif code == SYNC_WRITE and count > 2 then
            local size = p:get_index(1)
            listed(p, 2, size + 1, function(at)
                add(p:get_index(at), p:get_index(0), size, at + 1)
            end)
        elseif code == BULK_READ and count > 3 then
            listed(p, 1, 3, function(at)
                add(p:get_index(at + 1), p:get_index(at + 2), p:get_index(at))
            end)
        end
    elseif code == READ and count == 4 then
        add(packet.id, u16(p, 0), u16(p, 2))
    elseif (code == WRITE or code == REG_WRITE) and count > 2 then
        add(packet.id, u16(p, 0), count - 2, 2)
    elseif (code == SYNC_READ or code == FAST_SYNC_READ) and count > 4 then
        listed(p, 4, 1, function(at) add(p:get_index(at), u16(p, 0), u16(p, 2)) end)
    elseif code == SYNC_WRITE and count > 4 then
        local size = u16(p, 2)
        listed(p, 4, size + 1, function(at)
            add(p:get_index(at), u16(p, 0), size, at + 1)
        end)
    elseif code == BULK_READ or code == FAST_BULK_READ then
        listed(p, 0, 5, function(at) add(p:get_index(at), u16(p, at + 1), u16(p, at + 3)) end)
    elseif code == BULK_WRITE then
        local at = 0
        while at + 5 < count and at + 5 + u16(p, at + 3) <= count do
            local size = u16(p, at + 3)
            add(p:get_index(at), u16(p, at + 1), size, at + 5)
            at = at + 5 + size
        end
    end
    return found
end

local MUST_ANSWER = {[READ] = true, [SYNC_READ] = true, [BULK_READ] = true,
                     [FAST_SYNC_READ] = true, [FAST_BULK_READ] = true}

--- Who may answer, and who has to: {left = {[id] = access or true}, must = {...}}.
local function expectation(packet, key, number, time)
    local waiting = {key = key, frame = number, time = time, code = packet.code, left = {}, must = {},
                     accesses = packet.accesses}
    local must = MUST_ANSWER[packet.code]
    if packet.id ~= BROADCAST or must then
        if packet.id ~= BROADCAST then waiting.left[packet.id] = true end
        if packet.code == PING then waiting.must[packet.id] = true end
        for _, access in ipairs(packet.accesses) do
            if must then
                waiting.left[access.id], waiting.must[access.id] = access, true
            end
        end
    end
    return waiting
end

-- --- control tables -------------------------------------------------------------------------

local function learn_devices(text)
    local by_name, known = {}, {}
    for number, model in pairs(tables.models) do by_name[model[1]:upper()] = number end
    for first, last, name in text:gmatch('(%d+)%-?(%d*):([^,%s]+)') do
        for id = tonumber(first), tonumber(last) or tonumber(first) do
            known[id] = by_name[name:upper()]
        end
    end
    return known
end

local function layout_of(bus, id)
    local number = models[bus .. ' ' .. id] or learn_devices(servobus.prefs.devices)[id]
    local model = number and tables.models[number]
    if not model then return nil, nil end
    if not model.registers then
        model.registers = {}
        local runs = tables.layouts[model[2]]
        for at = 1, #runs, 2 do
            for which = runs[at], runs[at + 1] do
                model.registers[#model.registers + 1] = tables.registers[which]
            end
        end
    end
    return model.registers, model[1]
end

local LAYOUTS = {u8 = 'B', i8 = 'b', u16 = 'H', i16 = 'h', u32 = 'I4', i32 = 'i4', u64 = 'E',
                 i64 = 'e', f32 = 'f', f64 = 'd'}

local function number_of(kind, bytes)                                  -- kind: '<i32'
    local number = Struct.unpack(kind:sub(1, 1) .. LAYOUTS[kind:sub(2)], bytes:raw())
    return type(number) == 'number' and number or number:tonumber()     -- of 64 bits
end

--- The name and the value of a register, a number where it is one.
local function meaning(register, bytes)
    local _, _, name, kind, unit, scale, offset, sign, words, is_raw =
        table.unpack(register, 1, 10)
    local number = number_of(kind, bytes)
    local word = words and words[number]
    if is_raw or type(word) == 'string' then return name, word or tostring(number), nil end
    if sign then
        local magnitude = number % 2 ^ sign
        number = number % 2 ^ (sign + 1) == magnitude and magnitude or -magnitude
    end
    if word then
        number = word
    elseif words and not scale then
        return name, ('unknown (%d)'):format(number), nil
    elseif scale then
        number = number * scale + (offset or 0)
    end
    return name, ('%.6g %s'):format(number, unit or ''):gsub('%s+$', ''), number
end

-- --- the tree -------------------------------------------------------------------------------

--- `range`: the bytes of `data` in the packet. Returns the registers in words, and their names.
local function show_registers(tree, bus, access, data, range, error_byte)
    local registers, model = layout_of(bus, access.id)
    local texts, names = {}, {}
    local branch = tree:add(fields.device, access.id):append_text(model and ' ' .. model or '')
    branch:add(fields.address, access.address)
    branch:add(fields.size, access.size)
    if error_byte then branch:add(fields.error, error_byte) end
    if data and data:len() > 0 then branch:add(fields.data, range or data:tvb('data')()) end
    for _, register in ipairs(registers or {}) do
        local at = register[1] - access.address
        if at >= 0 and at + register[2] <= access.size then
            names[#names + 1] = register[3]
            if data == nil then
                branch:add(fields.register, register[3])
                texts[#texts + 1] = register[3]
            elseif at + register[2] <= data:len() then
                local name, text, number = meaning(register, slice(data, at, register[2]))
                local line = branch:add(fields.register, name .. ': ' .. text)
                if number then line:add(fields.value, number) end
                texts[#texts + 1] = name .. ' ' .. text
            end
        end
    end
    return texts, names
end

--- The parts of a combined status: {access, error, data}; each but the last ends with a CRC.
local function blocks_of(packet, waiting)
    local found, at, params = {}, 0, packet.params
    local error_byte = packet.error
    for number, access in ipairs(waiting.accesses) do
        if number > 1 then
            if at + 2 > params:len() then break end
            error_byte = params:get_index(at)
            at = at + 1
        end
        if at + 1 + access.size > params:len() or params:get_index(at) ~= access.id then break end
        found[#found + 1] = {access = access, error = error_byte, at = at + 1,
                             data = slice(params, at + 1, access.size)}
        at = at + 1 + access.size + 2
    end
    return found
end

local function error_words(packet, family)
    if packet.error == 0 then return '' end
    if packet.protocol == '2' then
        local code = packet.error % ALERT
        local words = code > 0 and (tables.errors['2'][code] or ('error %d'):format(code)) or nil
        return table.concat({words, packet.error >= ALERT and 'alert' or nil}, ', ')
    end
    local words = {}
    for number = 0, 7 do
        if bit.band(packet.error, bit.lshift(1, number)) ~= 0 then
            words[#words + 1] = tables.errors[family][number] or ('bit %d'):format(number)
        end
    end
    return table.concat(words, ', ')
end

local function family_of(packet)
    if packet.protocol == '2' then return '2' end
    return servobus.prefs.family == 2 and 'feetech' or '1'
end

local function name_of(packet, family)
    if packet.is_status then return 'Status' end
    return tables.instructions[family][packet.code] or ('instruction 0x%02X'):format(packet.code)
end

--- On the first pass: what a packet belongs to.
local function track(packet, bus, key, number, time)
    local waiting = pending[bus]
    if not packet.is_status then
        if waiting then
            for id in pairs(waiting.must) do
                missing[waiting.key] = missing[waiting.key] or {}
                table.insert(missing[waiting.key], id)
            end
        end
        packet.accesses = accesses_of(packet)
        pending[bus] = expectation(packet, key, number, time)
        return
    end
    if not waiting then return end
    local is_combined = waiting.code == FAST_SYNC_READ or waiting.code == FAST_BULK_READ
    local access = waiting.left[packet.id]
    if is_combined and packet.id == BROADCAST then
        packet.blocks = blocks_of(packet, waiting)
        for _, block in ipairs(packet.blocks) do waiting.must[block.access.id] = nil end
    elseif waiting.code == PING then
        packet.is_pong = true
    elseif access == nil then
        return
    elseif access ~= true and access.size == packet.params:len() then
        packet.access = access
    end
    waiting.left[packet.id], waiting.must[packet.id] = nil, nil
    packet.request, packet.ms = waiting.frame, 1000 * (time - waiting.time)
    links[waiting.key] = links[waiting.key] or {}
    table.insert(links[waiting.key], number)
    local p = packet.params
    if packet.is_pong and packet.protocol == '2' and p:len() == 3 then
        models[bus .. ' ' .. packet.id] = u16(p, 0)
    elseif packet.access and packet.access.address == MODEL_NUMBER[family_of(packet)]
            and p:len() >= 2 then
        models[bus .. ' ' .. packet.id] = u16(p, 0)
            + (family_of(packet) == 'feetech' and FEETECH_KEY or 0)
    end
end

local function dissect_noise(tvb, pinfo, tree, why)
    pinfo.cols.protocol = 'servobus'
    pinfo.cols.info = why
    local branch = tree:add(servobus, tvb())
    branch:add(fields.noise, tvb())
    branch:add_proto_expert_info(why == 'no packet' and experts.noise or experts.damaged, why)
end

local function show(packet, bus, key, tvb, pinfo, tree)
    local family = family_of(packet)
    local name, words = name_of(packet, family), packet.is_status and error_words(packet, family)
    local info = packet.id == BROADCAST and name or ('%s %03d'):format(name, packet.id)
    local texts = {}
    --- Where parameters are in the packet; nowhere if they are stuffed.
    local function range(from, size)
        local is_stuffed = packet.params:len() ~= packet.size
        return not is_stuffed and size > 0 and tvb(packet.from - packet.shift + from, size) or nil
    end
    local branch = tree:add(servobus, tvb())
    branch:add(fields.protocol, ({['2'] = '2.0', ['1'] = '1.0', feetech = 'Feetech'})[family])
    local at = (packet.protocol == '2' and 4 or 2) - packet.shift
    branch:add(fields.id, tvb(at, 1))
    branch:add(fields.length, tvb(at + 1, packet.protocol == '2' and 2 or 1), packet.length)
    branch:add(fields.instruction, tvb(at + (packet.protocol == '2' and 3 or 2), 1),
        packet.code)
    branch:add(fields.name, name)
    if packet.is_status then
        local item = branch:add(fields.error, tvb(packet.from - 1 - packet.shift, 1))
        if words ~= '' then
            item:append_text(' (' .. words .. ')')
            item:add_proto_expert_info(experts.error, words)
            info = info .. ', ' .. words
        end
    end
    if packet.size > 0 then
        branch:add(fields.params, range(0, packet.size) or packet.params:tvb('Parameters')())
    end
    if packet.is_pong and packet.params:len() == 3 then
        local number = u16(packet.params, 0)
        local model = tables.models[number]
        branch:add(fields.model_number, number)
        if model then branch:add(fields.model, model[1]) end
        branch:add(fields.firmware, packet.params:get_index(2))
        info = info .. (model and ', ' .. model[1] or ', model ' .. number)
    end
    for _, access in ipairs(packet.accesses or {}) do
        local found, names = show_registers(branch, bus, access, access.data,
            access.at and range(access.at, access.size))
        texts = #packet.accesses > 1 and names or found
    end
    for _, block in ipairs(packet.blocks or {}) do
        _, texts = show_registers(branch, bus, block.access, block.data,
            range(block.at, block.access.size), block.error)
    end
    if packet.access then
        texts = show_registers(branch, bus, packet.access, packet.params, range(0, packet.size))
    end
    if #texts > 0 then info = info .. ': ' .. table.concat(texts, ', ') end
    branch:add(fields.checksum, packet.checksum)
    if packet.request then
        branch:add(fields.request, packet.request):set_generated()
        branch:add(fields.time, packet.ms):set_generated()
        info = info .. (', %.3f ms'):format(packet.ms)
    end
    for _, frame in ipairs(links[key] or {}) do
        branch:add(fields.response, frame):set_generated()
    end
    for _, id in ipairs(missing[key] or {}) do
        branch:add(fields.missing, id):set_generated()
        local text = ('no answer from %03d'):format(id)
        branch:add_proto_expert_info(experts.missing, text)
        info = info .. ', ' .. text
    end
    pinfo.cols.protocol = 'servobus'
    pinfo.cols.info = info
    pinfo.cols.src = packet.is_status and ('%03d'):format(packet.id) or 'master'
    pinfo.cols.dst = packet.is_status and 'master'
        or packet.id == BROADCAST and 'all' or ('%03d'):format(packet.id)
end

--- `key`: of the packet; its frame, and which one of that it is.
local function dissect(tvb, bus, way, key, pinfo, tree)
    if not pinfo.visited or packets[key] == nil then
        local bytes, packet, why = tvb:bytes(), nil, 'no packet'
        local whole, missing_bytes = whole_2(bytes)
        if whole then
            packet, why = parse_2(whole, missing_bytes)
        elseif tvb:len() > 1 and tvb(0, 2):uint() == 0xFFFF then
            packet, why = parse_1(bytes, way, pending[bus])
        end
        if packet then track(packet, bus, key, pinfo.number, pinfo.rel_ts) end
        packets[key] = packet or why
    end
    local packet = packets[key]
    if type(packet) == 'string' then
        dissect_noise(tvb, pinfo, tree, packet)
    else
        show(packet, bus, key, tvb, pinfo, tree)
    end
end

function servobus.dissector(tvb, pinfo, tree)
    if tvb:len() == 0 then
        pinfo.cols.protocol = 'servobus'
        pinfo.cols.info = 'event: see the comment'
        return 0
    end
    dissect(tvb, tostring(interface() and interface().value or 0),
        direction() and direction().value, pinfo.number, pinfo, tree)
    return tvb:len()
end

DissectorTable.get('wtap_encap'):add(wtap.USER0, servobus)

-- --- a serial adapter on USB ----------------------------------------------------------------

local SUBMITTED, COMPLETED, BULK, CONTROL = 0x53, 0x43, 3, 2       -- 'S', 'C', as in usbmon
local FTDI, DESCRIPTOR = 0x0403, '\18\1'

--- What an adapter of FTDI sent, without the two bytes of state that begin each packet of USB.
local function without_state(text)
    local size, found = text:byte(1) and bit.band(text:byte(1), 2) ~= 0 and 512 or 64, {}
    for at = 1, #text, size do found[#found + 1] = text:sub(at + 2, at + size - 1) end
    return table.concat(found)
end

--- The whole packets in the bytes of one side, and the bytes that are left. Others are passed over.
local function cut(text, way)
    local found, at = {}, 1
    while true do
        at = text:find('\255\255', at, true)
        if not at then return found, text:sub(-1) == '\255' and '\255' or '' end
        local is_2 = text:sub(at + 2, at + 3) == '\253\0'
        if #text < at + (is_2 and 6 or 3) then return found, text:sub(at) end
        local size = is_2 and 7 + text:byte(at + 5) + 256 * text:byte(at + 6)
            or 4 + text:byte(at + 3)
        local bytes = ByteArray.new(text:sub(at, at + size - 1), true)
        if size <= 1031 and #text < at + size - 1 then return found, text:sub(at) end
        if is_2 and parse_2(bytes, 0) or not is_2 and parse_1(bytes, way) then
            found[#found + 1] = bytes
            at = at + size
        else
            at = at + 1
        end
    end
end

local function look(tvb, pinfo, tree, head)
    local header, kind, transfer, endpoint, bus = head(tvb)
    local is_in = endpoint >= 0x80
    if tvb:len() <= header or kind ~= (is_in and COMPLETED or SUBMITTED) then return end
    local text = tvb(header):bytes():raw()
    if transfer == CONTROL then
        local at = text:find(DESCRIPTOR, 1, true)
        if at and #text >= at + 17 then
            is_ftdi[bus] = text:byte(at + 8) + 256 * text:byte(at + 9) == FTDI
        end
    end
    if transfer ~= BULK then return end
    local way = is_in and INBOUND or OUTBOUND
    if found_on_usb[pinfo.number] == nil then
        if is_ftdi[bus] == nil and is_in then      -- it was plugged in before: by an empty answer
            is_ftdi[bus] = #text == 2 and bit.band(text:byte(1), 0x0F) ~= 0 or nil
        end
        if is_ftdi[bus] and is_in then text = without_state(text) end
        local side = bus .. ' ' .. way
        found_on_usb[pinfo.number], streams[side] = cut((streams[side] or '') .. text, way)
    end
    for which, bytes in ipairs(found_on_usb[pinfo.number]) do
        dissect(bytes:tvb('Packet on the bus'), bus, way, pinfo.number .. '.' .. which, pinfo, tree)
    end
end

--- Return size of the header, 'S' or 'C', kind of transfer, endpoint, and the device in words.
local function usbmon(size)
    return function(tvb)
        return size, tvb(8, 1):uint(), tvb(9, 1):uint(), tvb(10, 1):uint(),
            ('usb %d.%d'):format(tvb(12, 2):le_uint(), tvb(11, 1):uint())
    end
end

local function usbpcap(tvb)
    return tvb(0, 2):le_uint(), bit.band(tvb(16, 1):uint(), 1) == 1 and COMPLETED or SUBMITTED,
        tvb(22, 1):uint(), tvb(21, 1):uint(),
        ('usb %d.%d'):format(tvb(17, 2):le_uint(), tvb(19, 2):le_uint())
end

local link_types = DissectorTable.get('wtap_encap')
for encap, head in pairs({[wtap.USB_LINUX] = usbmon(48), [wtap.USB_LINUX_MMAPPED] = usbmon(64),
                          [wtap.USBPCAP] = usbpcap}) do
    local usb = link_types:get_dissector(encap)
    local both = Proto('servobus_usb' .. encap, 'Servo bus on USB, link type ' .. encap)
    function both.dissector(tvb, pinfo, tree)
        usb:call(tvb, pinfo, tree)
        look(tvb, pinfo, tree, head)
        return tvb:len()
    end
    link_types:add(encap, both)
end
