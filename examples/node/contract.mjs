// Loads a .proto file and returns what its package `oaisys.v1` defines.
import grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";

export function loadContract(root, file) {
  const definition = loadSync(file, {
    includeDirs: [root],
    keepCase: true,
    longs: Number,
    enums: String,
    defaults: true,
    oneofs: true,
  });
  return grpc.loadPackageDefinition(definition).oaisys.v1;
}
