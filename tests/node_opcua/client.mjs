// A client of OPC UA that knows OPC 10000-9, DI and OPC 40001-1, and none of our names. Prints one JSON object.
//   node client.mjs look URL CERTIFICATE KEY FOLDER [USER PASSWORD]     find, refresh, acknowledge
//   node client.mjs follow URL CERTIFICATE KEY FOLDER COUNT             COUNT events of alarms, after the line "ready"
import { OPCUACertificateManager } from "node-opcua-certificate-manager";
import {
  AttributeIds, BrowseDirection, DataType, MessageSecurityMode, OPCUAClient, SecurityPolicy, TimestampsToReturn,
  UserTokenType, acknowledgeCondition, constructEventFilter, findActiveConditions, resolveNodeId,
} from "node-opcua-client";

const DI = "http://opcfoundation.org/UA/DI/", MACHINERY = "http://opcfoundation.org/UA/Machinery/";
const [mode, url, certificateFile, privateKeyFile, rootFolder, ...rest] = process.argv.slice(2);
const manager = new OPCUACertificateManager({ rootFolder, automaticallyAcceptUnknownCertificate: true });
await manager.initialize();
const client = OPCUAClient.create({
  applicationUri: "urn:test:client", certificateFile, privateKeyFile, clientCertificateManager: manager,
  securityMode: MessageSecurityMode.SignAndEncrypt, securityPolicy: SecurityPolicy.Basic256Sha256,
  endpointMustExist: false, connectionStrategy: { maxRetry: 0 },
});

async function below(session, nodeId, referenceTypeId = "HierarchicalReferences") {
  const found = await session.browse({
    nodeId, referenceTypeId, includeSubtypes: true, browseDirection: BrowseDirection.Forward, nodeClassMask: 0, resultMask: 63,
  });
  return found.references ?? [];
}

async function look(session, said) {
  const uris = await session.readNamespaceArray();
  const [di, machinery] = [uris.indexOf(DI), uris.indexOf(MACHINERY)];
  const has = async (one, type) =>
    (await below(session, one.nodeId)).find((part) => part.typeDefinition.toString() === `ns=${machinery};i=${type}`);
  said.machines = [];
  for (const machine of await below(session, `ns=${machinery};i=1001`)) {
    if (!(await has(machine, 1012))) continue; // MachineIdentificationType
    const valves = [];
    for (const one of await below(session, (await has(machine, 1006)).nodeId))
      if (await has(one, 1005)) valves.push(one.displayName.text); // MachineryComponentIdentificationType
    said.machines.push({ name: machine.displayName.text, valves });
  }
  const active = await findActiveConditions(session); // by ConditionRefresh
  said.active = active.map((one) => ({ name: one.conditionName.value, acknowledged: one.ackedState.id.value }));
  said.types = active.map((one) => one.eventType.value.toString().replace(`ns=${di};`, "DI "));
  const waiting = active.find((one) => !one.ackedState.id.value);
  const status = await acknowledgeCondition(session, waiting.conditionId.value, waiting.eventId.value, "seen by node-opcua");
  said.acknowledge = status.name;
}

async function follow(session, said, count) {
  const subscription = await session.createSubscription2({
    requestedPublishingInterval: 50, requestedLifetimeCount: 1000, requestedMaxKeepAliveCount: 100,
    maxNotificationsPerPublish: 10000, publishingEnabled: true, priority: 1,
  });
  const item = await subscription.monitor(
    { nodeId: resolveNodeId("Server"), attributeId: AttributeIds.EventNotifier },
    { queueSize: 10000, discardOldest: true, samplingInterval: 0,
      filter: constructEventFilter(["SourceName", "Time", "ActiveState.Id"]) },
    TimestampsToReturn.Both,
  );
  const arrived = [];
  await new Promise((resolve) => {
    item.on("changed", ([source, time, active]) => {
      if (active.dataType !== DataType.Boolean) return;
      arrived.push([source.value, active.value, Date.now() - time.value.getTime()]);
      if (arrived.length === count) resolve();
    });
    console.log("ready");
  });
  said.arrived = arrived;
}

const said = {};
try {
  await client.connect(url);
  const [first, second] = rest;
  const user = mode === "look" && first ? { type: UserTokenType.UserName, userName: first, password: second } : undefined;
  const session = await client.createSession(user);
  await (mode === "look" ? look(session, said) : follow(session, said, Number(first)));
  await session.close();
} catch (error) {
  said.refused = error.message.split("\n")[0];
}
await client.disconnect();
console.log(JSON.stringify(said));
process.exit(0);
