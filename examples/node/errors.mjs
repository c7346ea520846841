// Reads what an error says of the request's fields: google.rpc.BadRequest in the status' details.
import protobuf from "protobufjs";

const { root } = protobuf.parse(`
  syntax = "proto3";
  message Status { int32 code = 1; string message = 2; repeated Detail details = 3; }
  message Detail { string type_url = 1; bytes value = 2; }
  message BadRequest { repeated FieldViolation field_violations = 1; }
  message FieldViolation { string field = 1; string description = 2; }
`);
const Status = root.lookupType("Status");
const BadRequest = root.lookupType("BadRequest");

/** The refused fields of a failed call, each with what is wrong with it. */
export function fieldViolations(error) {
  const [status] = error.metadata?.get("grpc-status-details-bin") ?? [];
  if (!status) {
    return [];
  }
  return Status.decode(status)
    .details.filter((detail) => detail.typeUrl.endsWith("/google.rpc.BadRequest"))
    .flatMap((detail) => BadRequest.decode(detail.value).fieldViolations);
}
