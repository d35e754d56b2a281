// Reads the history of a node with node-opcua, and prints what came as one line of JSON:
//   node history.js ENDPOINT NODE BEGIN END PAGE
const {
  OPCUAClient, AttributeIds, AggregateFunction, HistoryReadRequest, ReadRawModifiedDetails,
  ReadAtTimeDetails, TimestampsToReturn, coerceNodeId,
} = require("node-opcua-client");

const [endpoint, node, begin, end, page] = process.argv.slice(2);
const start = new Date(begin), stop = new Date(end);
const shown = (values) => values.map((one) => [
  one.sourceTimestamp.getTime(), one.value.value ?? null, one.statusCode.name,
]);

async function raw(session) {
  const values = [];
  let pages = 0, point;
  const begun = process.hrtime.bigint();
  do {
    const answer = await session.performMessageTransaction(new HistoryReadRequest({
      historyReadDetails: new ReadRawModifiedDetails({
        isReadModified: false, startTime: start, endTime: stop, numValuesPerNode: Number(page),
      }),
      timestampsToReturn: TimestampsToReturn.Source,
      nodesToRead: [{ nodeId: coerceNodeId(node), continuationPoint: point }],
    }));
    const result = answer.results[0];
    if (!result.statusCode.isGood()) throw new Error(result.statusCode.name);
    values.push(...result.historyData.dataValues);
    pages += 1;
    point = result.continuationPoint?.length ? result.continuationPoint : undefined;
  } while (point);
  return { values, pages, seconds: Number(process.hrtime.bigint() - begun) / 1e9 };
}

async function atTimes(session, times) {
  const answer = await session.performMessageTransaction(new HistoryReadRequest({
    historyReadDetails: new ReadAtTimeDetails({ reqTimes: times }),
    timestampsToReturn: TimestampsToReturn.Source,
    nodesToRead: [{ nodeId: coerceNodeId(node) }],
  }));
  return answer.results[0].historyData.dataValues;
}

async function main() {
  const client = OPCUAClient.create({
    endpointMustExist: false, connectionStrategy: { maxRetry: 3 },
  });
  await client.connect(endpoint);
  const session = await client.createSession();
  try {
    const { value } = await session.read({ nodeId: node, attributeId: AttributeIds.AccessLevel });
    const { values, pages, seconds } = await raw(session);
    const aggregates = {};
    for (const name of ["Average", "Minimum", "Maximum", "Count"]) {
      const result = await session.readAggregateValue(
        { nodeId: node }, start, new Date(start.getTime() + 30000), AggregateFunction[name], 10000,
      );
      aggregates[name] = shown(result.historyData.dataValues);
    }
    const times = [4000, -1000].map((ms) => new Date(start.getTime() + ms));
    const written = await session.write({
      nodeId: node, attributeId: AttributeIds.Value,
      value: { value: { dataType: "Double", value: 1 } },
    });
    console.log(JSON.stringify({
      accessLevel: value.value, pages, seconds, count: values.length,
      values: shown(values.slice(0, 100)), aggregates,
      atTimes: shown(await atTimes(session, times)), written: written.name,
    }));
  } finally {
    await session.close();
    await client.disconnect();
  }
}

main().catch((error) => { console.error(error.message); process.exit(1); });
