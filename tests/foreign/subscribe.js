// Subscribes to a node with node-opcua, and prints a line of JSON for whatever comes until it is ended:
//   node subscribe.js ENDPOINT NODE
// {"value", "status", "source"} for a value, {"connected"} when the connection breaks or is back.
// Each line has "requests", the number of requests that the client has sent, by service.
const { OPCUAClient, AttributeIds, TimestampsToReturn } = require("node-opcua-client");

const [endpoint, node] = process.argv.slice(2);
const requests = {};
const print = (line) => console.log(JSON.stringify({ ...line, requests }));

async function main() {
  const client = OPCUAClient.create({
    endpointMustExist: false,
    connectionStrategy: { maxRetry: -1, initialDelay: 200, maxDelay: 2000 },
  });
  client.on("send_request", (request) => {
    const name = request.constructor.name;
    requests[name] = (requests[name] ?? 0) + 1;
  });
  client.on("connection_lost", () => print({ connected: false }));
  client.on("connection_reestablished", () => print({ connected: true }));
  await client.connect(endpoint);
  const session = await client.createSession();
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 500, requestedLifetimeCount: 100, requestedMaxKeepAliveCount: 10,
    publishingEnabled: true,
  });
  const item = await subscription.monitor(
    { nodeId: node, attributeId: AttributeIds.Value },
    { samplingInterval: 200, discardOldest: true, queueSize: 10 }, TimestampsToReturn.Both,
  );
  item.on("changed", ({ value, statusCode, sourceTimestamp }) => print({
    value: value.value ?? null, status: statusCode.name, source: sourceTimestamp?.toISOString(),
  }));
  setInterval(() => print({}), 1000);
}

main().catch((error) => { console.error(error.message); process.exit(1); });
